"""Make the views of the mapping benchmarks: a seeded walk through a scene, and held-out views of the observed part.

The walk has the clearance, steps and turns of an episode, and every fifth frame is a keyframe. It is planned in the
true free space, so it depends only on the scene and the seed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from activestructure_gym.errors import InputError
from activestructure_gym.geometry import PinholeCamera, look_along, transform_points
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.ground_truth import ground_truth_of
from activestructure_gym.motion import MotionConfig, interpolate, path_lengths
from activestructure_gym.motion.trajectory import poses_at
from activestructure_gym.scenes.scene import Scene
from activestructure_gym.sensors.renderer import make_renderer
from activestructure_gym.volume import VoxelVolume
from activestructure_gym.volume.integration import FREE

KEYFRAME_EVERY = 5  # frames between keyframes, as in an episode
_PITCH_DEG = (-30.0, 15.0)  # range of the pitch of views in degrees; negative is down
_TRIES = 200  # number of successive goals without a path after which an error is raised
_SEEN_WITHIN = (0.03, 0.01)  # tolerance between a point and a measured depth: 0.03 m + 0.01 times the depth
_SEEN_FROM = 1.5  # largest depth of a point in a keyframe, as a multiple of its depth in the held-out view


def true_volume(scene: Scene) -> VoxelVolume:
    """Return a voxel volume for path planning in which the true free space of a scene is free."""
    volume = VoxelVolume(scene.bounds)
    centers = volume.center_of(np.argwhere(np.ones(volume.shape, bool)))
    volume.state[ground_truth_of(scene).free_space.clearance_at(centers).reshape(volume.shape) > 0] = FREE
    return volume


def random_walk(
    volume: VoxelVolume,
    start: np.ndarray,  # [4, 4] world_from_camera
    frames: int,
    rng: np.random.Generator,
    *,
    goal_allowed: Callable[[np.ndarray], np.ndarray] | None = None,  # [N, 3] metres -> [N] bool
) -> np.ndarray:  # [frames, 4, 4] world_from_camera, including the start
    """Walk between random goals for a number of ``frames``, with a random view direction at each goal.

    Goals are uniform over the voxels that have the clearance of candidate views and are within 0.2 m of the start's
    height. ``goal_allowed`` further limits the goals. Raise `InputError` if no goal can be reached.
    """
    motion = MotionConfig()
    centers = volume.center_of(np.argwhere(volume.clearance >= motion.candidate_clearance))
    goals = centers[np.abs(centers[:, 2] - start[2, 3]) <= 0.2]
    if goal_allowed is not None:
        goals = goals[goal_allowed(goals)]
    walked = [start]
    failed = 0
    while len(walked) < frames:
        here = walked[-1]
        path = None
        if len(goals):
            distances = path_lengths(volume, here[:3, 3], min_clearance=motion.min_clearance)
            path = distances.path_to(goals[rng.integers(len(goals))])
        yaw, pitch = rng.uniform(-np.pi, np.pi), np.radians(rng.uniform(*_PITCH_DEG))
        if path is None or len(path) < 2:
            failed += 1
            if failed >= _TRIES or not len(goals):
                raise InputError(f"a random walk from {start[:3, 3].round(2)} finds no place to go to")
            continue
        failed = 0
        goal = poses_at(path[-1:], np.array([yaw]), np.array([pitch]))[0]
        walked += list(interpolate(path, here, goal, motion))
    return np.stack(walked[:frames])


def capture(
    scene: Scene,
    camera: PinholeCamera,
    poses: np.ndarray,  # [F, 4, 4] world_from_camera
    *,
    supersample: int,
    max_range: float = 10.0,  # metres, as for the default sensor; larger depths become 0
    advance: Callable[[], None] = lambda: None,
) -> list[Frame]:
    """Render one noise-free frame per pose; ``advance`` is called after each frame."""
    renderer = make_renderer("raycast", scene)
    frames = []
    try:
        for pose in poses:
            rgb, depth = renderer.render(camera, pose, supersample=supersample)
            frames.append(Frame(rgb, np.where(depth <= max_range, depth, np.float32(0.0)), pose, camera))
            advance()
    finally:
        renderer.close()
    return frames


def observed_share(
    points: np.ndarray,  # [N, 3] metres, world
    depth: np.ndarray,  # [N] metres along the optical axis of the view
    keyframes: Sequence[Frame],
) -> float:
    """Return the share of the surface points of a view that keyframes have measured from a similar distance.

    A point counts if, in some keyframe, it is in the image, agrees with the measured depth, and has at most 1.5 times
    its depth in the view. No mapper can render a surface sharply that was measured only from far away.
    """
    left, farthest = np.asarray(points), _SEEN_FROM * np.asarray(depth)
    for frame in keyframes:
        if not len(left):
            break
        rotation, position = frame.world_from_camera[:3, :3], frame.world_from_camera[:3, 3]
        local = (left - position) @ rotation
        camera = frame.camera
        z = np.maximum(local[:, 2], 1e-9)
        column = np.floor(camera.fx * local[:, 0] / z + camera.cx)
        row = np.floor(camera.fy * local[:, 1] / z + camera.cy)
        inside = (local[:, 2] > 0) & (row >= 0) & (row < camera.height) & (column >= 0) & (column < camera.width)
        measured = np.zeros(len(left), dtype=np.float32)
        measured[inside] = frame.depth[row[inside].astype(int), column[inside].astype(int)]
        floor, growth = _SEEN_WITHIN
        seen = (measured > 0) & (np.abs(measured - local[:, 2]) <= floor + growth * local[:, 2])
        seen &= local[:, 2] <= farthest
        left, farthest = left[~seen], farthest[~seen]
    return 1.0 - len(left) / max(1, len(points))


def held_out_poses(
    scene: Scene,
    camera: PinholeCamera,
    keyframes: Sequence[Frame],
    count: int,
    rng: np.random.Generator,
    *,
    least_observed: float = 0.9,  # least share of the pixels of a view
    tries: int = 4000,  # largest number of views that are drawn
) -> np.ndarray:  # [count, 4, 4] world_from_camera
    """Draw ``count`` held-out views in free space that show surfaces which the keyframes have observed.

    Positions are uniform at least 0.3 m from surfaces, headings are uniform, and the pitch is as in the walk. A view is
    accepted if at least the share ``least_observed`` of its pixels is observed (`observed_share`). So the views measure
    the quality of the map and not exploration. Raise `InputError` if too few such views are found.
    """
    thin = PinholeCamera.from_size(camera.width // 5, camera.height // 5)  # enough pixels to estimate the share
    renderer = make_renderer("raycast", scene)
    found: list[np.ndarray] = []
    try:
        for _ in range(tries):
            position = ground_truth_of(scene).free_space.sample_positions(1, rng, min_clearance=0.3)[0]
            yaw, pitch = rng.uniform(-np.pi, np.pi), np.radians(rng.uniform(*_PITCH_DEG))
            pose = look_along(
                position, np.array([np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), np.sin(pitch)])
            )
            depth = renderer.render(thin, pose, supersample=1)[1]
            points = transform_points(pose, thin.backproject(depth)[depth > 0].astype(np.float64))
            share = observed_share(points, depth[depth > 0], keyframes) * len(points) / depth.size
            if share >= least_observed:
                found.append(pose)
                if len(found) == count:
                    return np.stack(found)
    finally:
        renderer.close()
    raise InputError(
        f"only {len(found)} of {count} held-out views see at least {100 * least_observed:.0f} % observed surface "
        f"in '{scene.name}'; give more keyframes or a smaller share"
    )
