"""Define a world, here a simulated robot, and explore it.

python examples/05_own_world.py
"""

from activestructure_gym.geometry.frame import Frame
from activestructure_gym.policies import make_env_and_policy
from activestructure_gym.worlds import Start, load_world


class Robot:
    """Simulate a robot; replace every use of ``self.robot`` by calls to your own."""

    def __init__(self, width: int = 96, height: int = 54):
        self.robot = load_world(f"simulated?scene=room&width={width}&height={height}")
        self.bounds = self.robot.bounds
        self.camera = self.robot.camera

    @property
    def start(self) -> Start:
        """Return the current pose, and the radius in metres of the free space around it."""
        return Start(self.robot.start.pose, free_radius=0.5)

    def capture(self, world_from_camera) -> Frame:
        """Go to a pose [4, 4], and return the frame taken there."""
        frame = self.robot.capture(world_from_camera)
        return Frame(
            rgb=frame.rgb,  # [H, W, 3] uint8
            depth=frame.depth,  # [H, W] metres along the optical axis
            world_from_camera=frame.world_from_camera,  # the pose where it was taken
            camera=self.camera,
        )

    def close(self) -> None:
        """Release the robot."""
        self.robot.close()


if __name__ == "__main__":
    env, policy = make_env_and_policy("unknown_volume", Robot(), preset="fast", frame_budget=60)
    policy.reset(0)
    observation, info = env.reset(seed=0)
    while info["frames"] < 60 and observation["action_mask"].any():
        observation, reward, terminated, truncated, info = env.step(policy.act(observation))
    print(f"{info['gaussians']} Gaussians after {info['metres']:.1f} m")
    env.close()
