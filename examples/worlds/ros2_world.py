"""Explore with a robot by ROS 2 (Humble or later); the controller of Nav2 drives the robot along each path.

    PYTHONPATH=examples/worlds asg explore --world "ros2_world:Ros2World?bounds=-5,-5,0,5,5,2.5"

The robot's driver, its localisation and Nav2 must run. Depth images must be registered to colour images.
"""

import threading
import time

import numpy as np
import rclpy
import tf2_ros
from cv_bridge import CvBridge
from geometry_msgs.msg import Point, Pose, PoseStamped, Quaternion
from message_filters import ApproximateTimeSynchronizer, Subscriber
from nav2_msgs.action import FollowPath
from rclpy.action import ActionClient
from rclpy.duration import Duration
from rclpy.time import Time
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import CameraInfo, Image

from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.worlds import CaptureFailed, Start, checked_bounds, frame_from

TOPICS = {"color/image_raw": Image, "aligned_depth_to_color/image_raw": Image, "color/camera_info": CameraInfo}
WAIT = Duration(seconds=10.0)  # longest time to wait for images and transforms


class Ros2World:
    """Drive a robot along the planner's paths, and return the frames of its camera."""

    def __init__(self, bounds: tuple[float, ...], *, free_radius: float = 0.6, camera="/camera", fixed="map"):
        rclpy.init()
        self._node, self._seen = rclpy.create_node("explorer"), None
        self._fixed, self._free_radius = fixed, free_radius
        self._tf, self._drive = tf2_ros.Buffer(), ActionClient(self._node, FollowPath, "follow_path")
        self._listener = tf2_ros.TransformListener(self._tf, self._node)
        topics = [Subscriber(self._node, kind, f"{camera}/{name}") for name, kind in TOPICS.items()]
        self._together = ApproximateTimeSynchronizer(topics, 5, 0.05)
        self._together.registerCallback(lambda *messages: setattr(self, "_seen", messages))
        threading.Thread(target=rclpy.spin, args=(self._node,), daemon=True).start()
        colour, _, info = self._next()
        # In ROS, the origin of pixel coordinates is the centre of the first pixel; in this project it is its corner.
        self.camera = PinholeCamera(info.width, info.height, info.k[0], info.k[4], info.k[2] + 0.5, info.k[5] + 0.5)
        self.bounds, self._optical = checked_bounds(np.reshape(bounds, (2, 3))), colour.header.frame_id

    @property
    def start(self):
        # The camera's current pose. Its surroundings must be free when an episode begins.
        return Start(self._pose(self._fixed, self._optical, Time()), self._free_radius)

    def travel(self, path):
        goal = FollowPath.Goal()
        goal.path.header.frame_id = self._fixed
        for base in path @ self._pose(self._optical, "base_link", Time()):
            turn = Quaternion(**dict(zip("xyzw", Rotation.from_matrix(base[:3, :3]).as_quat())))
            place = Point(**dict(zip("xyz", base[:3, 3])))
            goal.path.poses.append(PoseStamped(header=goal.path.header, pose=Pose(position=place, orientation=turn)))
        self._drive.send_goal(goal)  # returns when the robot has stopped, at the end of the path or before

    def capture(self, world_from_camera):
        colour, depth, _ = self._next()
        rgb, metres = CvBridge().imgmsg_to_cv2(colour, "rgb8"), CvBridge().imgmsg_to_cv2(depth, "passthrough")
        metres = metres * np.float32(0.001 if depth.encoding == "16UC1" else 1.0)
        pose = self._pose(self._fixed, self._optical, Time.from_msg(colour.header.stamp))  # the pose really reached
        return frame_from(rgb, metres, pose, self.camera)

    def close(self):
        rclpy.try_shutdown()

    def _next(self):
        """Return the first colour image, depth image and camera info that are taken after this call."""
        began = self._node.get_clock().now()
        while self._seen is None or Time.from_msg(self._seen[0].header.stamp) < began:
            if self._node.get_clock().now() - began > WAIT:
                raise CaptureFailed("the camera sent no pictures within 10 s")
            time.sleep(0.01)
        return self._seen

    def _pose(self, target, source, when):
        """Return the transform [4, 4] from the frame ``source`` to the frame ``target`` at the time ``when``."""
        found = self._tf.lookup_transform(target, source, when, WAIT).transform
        turn, place, pose = found.rotation, found.translation, np.eye(4)
        pose[:3, :3] = Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]).as_matrix()
        pose[:3, 3] = place.x, place.y, place.z
        return pose
