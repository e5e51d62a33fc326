"""Define a policy, and play an episode with it.

python examples/02_own_policy.py
"""

from activestructure_gym.policies import POLICIES, Policy, make_env_and_policy, travel_discount
from activestructure_gym.policies.base import best_valid


@POLICIES.register("area_first")
class AreaFirst(Policy):
    """Choose the view with the most unknown surface behind its holes, discounted by travel."""

    required_features = ("hole_area",)

    def act(self, observation):
        """Return the row of the chosen candidate."""
        candidates = self.candidates(observation)
        return best_valid(candidates["hole_area"] * travel_discount(observation), observation)


if __name__ == "__main__":
    env, policy = make_env_and_policy(AreaFirst, scene="room", preset="fast")
    policy.reset(seed=0)
    observation, info = env.reset(seed=0)
    ended = False
    while not ended:
        observation, reward, terminated, truncated, info = env.step(policy.act(observation))
        ended = terminated or truncated
    print(f"{info['gaussians']} Gaussians after {info['frames']} frames and {info['metres']:.1f} m")
