"""Train PPO of RLlib with the project's network over candidate views, on one machine or on a cluster.

    pip install 'activestructure-gym[rllib]'
    python examples/rllib_ppo.py --iterations 2 --env-runners 2

On a cluster, start Ray (`ray start --head`, then `ray start --address=...` on the other machines) and add
`--address auto`. Every machine needs this package.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import ray
import tyro
from ray.rllib.algorithms.ppo import PPOConfig
from ray.rllib.core.columns import Columns
from ray.rllib.core.rl_module.apis import ValueFunctionAPI
from ray.rllib.core.rl_module.rl_module import RLModuleSpec
from ray.rllib.core.rl_module.torch import TorchRLModule
from ray.tune.registry import register_env

from activestructure_gym.policies.learned import with_used_keys
from activestructure_gym.policies.learned.config import NetworkConfig
from activestructure_gym.policies.learned.network import CandidateNetwork

ENV = "active_structure"


@dataclass
class Args:
    """Hold the command-line options."""

    env_id: str = "activestructure_gym:ActiveStructure/Room-v0"
    preset: str = "fast"
    frames: int = 60
    """Frame budget of an episode."""
    features: tuple[str, ...] = ("pixel", "hole_area")
    iterations: int = 50
    env_runners: int = 2
    """Processes that collect episodes; 0 collects in the main process."""
    steps: int = 256
    """Steps per iteration."""
    address: str | None = None
    """Address of a running cluster; if not given, Ray starts on this machine."""
    seed: int = 0


class CandidateModule(TorchRLModule, ValueFunctionAPI):
    """Adapt `CandidateNetwork` to RLlib; the masked scores of the candidates are the logits of the actions."""

    def setup(self) -> None:
        """Create the network; RLlib calls this instead of a constructor."""
        self.network = CandidateNetwork(NetworkConfig.from_dict(self.model_config["network"]))

    def _forward(self, batch: dict[str, Any], **_: Any) -> dict[str, Any]:
        scores, _ = self.network({key: value.float() for key, value in batch[Columns.OBS].items()})
        return {Columns.ACTION_DIST_INPUTS: scores}

    def compute_values(self, batch: dict[str, Any], embeddings: Any = None) -> Any:
        """Return the critic's values [B] of a batch of observations, which RLlib needs for advantages."""
        return self.network({key: value.float() for key, value in batch[Columns.OBS].items()})[1]


def make_env(config: dict[str, Any]) -> gym.Env[Any, Any]:
    """Make an environment whose observations have only the entries that the network reads."""
    options = dict(config)
    return with_used_keys(gym.make(options.pop("env_id"), disable_env_checker=True, **options))


def main(args: Args) -> list[float]:
    """Train a policy, and return the mean episode return of every iteration."""
    ray.init(address=args.address, ignore_reinit_error=True, include_dashboard=False, log_to_driver=False)
    register_env(ENV, make_env)
    config = (
        PPOConfig()
        .environment(
            ENV,
            env_config={
                "env_id": args.env_id,
                "preset": args.preset,
                "frame_budget": args.frames,
                "features": list(args.features),
            },
        )  # fmt: skip
        .env_runners(num_env_runners=args.env_runners, rollout_fragment_length="auto", batch_mode="complete_episodes")
        .training(
            train_batch_size_per_learner=args.steps,
            minibatch_size=min(64, args.steps),
            num_epochs=4,
            gamma=0.3,
            lambda_=0.95,
            lr=1e-3,
            entropy_coeff=0.003,
            clip_param=0.2,
        )
        .rl_module(
            rl_module_spec=RLModuleSpec(
                module_class=CandidateModule, model_config={"network": NetworkConfig(args.features).as_dict()}
            )
        )
        .debugging(seed=args.seed)
    )
    algorithm = config.build_algo()
    returns = []
    try:
        for iteration in range(args.iterations):
            numbers = algorithm.train()["env_runners"]
            returns.append(float(numbers["episode_return_mean"]))
            print(f"iteration {iteration + 1}: return {returns[-1]:.3f}", flush=True)
    finally:
        algorithm.stop()
        ray.shutdown()
    return returns


if __name__ == "__main__":
    main(tyro.cli(Args))
