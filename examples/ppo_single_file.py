"""Train PPO over candidate views in a single file, in the style of CleanRL.

    python examples/ppo_single_file.py --env-id activestructure_gym:ActiveStructure/Room-v0 --total-steps 8192

The network scores every row of the candidate table; the action mask excludes empty rows. The file does not use the
learned policies of this project. You can copy it and change the algorithm.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import gymnasium as gym
import numpy as np
import torch
import tyro
from torch import Tensor, nn

import activestructure_gym  # noqa: F401  (registers the environments)

# Entries of an observation that the network reads.
KEYS = ("pose", "budget", "candidates", "candidate_features", "action_mask", "plane_features", "candidate_planes")


@dataclass
class Args:
    """Hold the command-line options; the defaults are for short episodes on two cores."""

    env_id: str = "activestructure_gym:ActiveStructure/Room-v0"
    preset: str = "fast"
    features: tuple[str, ...] = ("pixel", "hole_area")
    frames: int | None = None
    """Frame budget of an episode; the preset's if not given."""
    seed: int = 0
    total_steps: int = 8192
    num_envs: int = 2
    processes: bool = False
    """One process per environment; faster if a step takes longer than 1 ms and cores are free."""
    num_steps: int = 64
    """Steps per environment and update."""
    learning_rate: float = 1e-3
    gamma: float = 0.3
    """Discount; small, since the reward of a view comes in the same step."""
    gae_lambda: float = 0.95
    minibatch: int = 64
    update_epochs: int = 4
    clip: float = 0.2
    entropy: float = 0.003
    value: float = 0.5
    max_grad_norm: float = 0.5


class Agent(nn.Module):
    """Score each candidate from its row, its visible planes, and the mean and maximum over all rows."""

    def __init__(self, features: int, plane_columns: int, width: int = 64) -> None:
        super().__init__()
        self.planes = nn.Sequential(nn.Linear(plane_columns, 24), nn.ReLU())
        self.rows = nn.Sequential(
            nn.Linear(7 + 2 * features + 24, width), nn.ReLU(), nn.Linear(width, width), nn.ReLU()
        )
        self.score = nn.Sequential(nn.Linear(3 * width + 1, width), nn.ReLU(), nn.Linear(width, 1))
        self.critic = nn.Sequential(nn.Linear(2 * width + 1, width), nn.ReLU(), nn.Linear(width, 1))
        nn.init.normal_(self.score[-1].weight, std=0.01)

    def forward(self, observation: dict[str, Tensor]) -> tuple[torch.distributions.Categorical, Tensor]:
        """Return the distribution over the K rows of each of B observations, and the values [B]."""
        mask = observation["action_mask"] > 0  # [B, K]
        table, features = observation["candidates"], observation["candidate_features"]
        offset = (table[..., :3] - observation["pose"][:, None, :3]) / 5.0
        discount = 1.0 / (1.0 + table[..., 7:8] / 5.0)  # column 7 is the number of frames of the path
        largest = (features.abs() * mask[..., None]).amax(1, keepdim=True).clamp(min=1e-6)
        seen = observation["candidate_planes"]
        # Plane features are scaled logarithmically, since areas and positions have no common scale.
        planes = self.planes(observation["plane_features"].sign() * observation["plane_features"].abs().log1p())
        summary = seen @ planes / (1.0 + seen.sum(-1, keepdim=True))
        row = torch.cat(
            [offset, table[..., 3:6], discount, features / largest, features * discount / largest, summary], -1
        )
        tokens = self.rows(row) * mask[..., None]
        mean = tokens.sum(1) / mask.sum(1, keepdim=True).clamp(min=1)
        common = torch.cat([mean, tokens.amax(1), observation["budget"]], -1)  # empty rows are 0, the least value
        spread = common[:, None].expand(-1, tokens.shape[1], -1)
        scores = self.score(torch.cat([tokens, spread], -1)).squeeze(-1)
        logits = torch.where(mask, scores, scores.new_full((), -1e8))
        return torch.distributions.Categorical(logits=logits), self.critic(common).squeeze(-1)


def tensors(observation: dict[str, np.ndarray]) -> dict[str, Tensor]:
    """Return the entries `KEYS` of an observation as float32 tensors."""
    return {key: torch.as_tensor(np.asarray(observation[key]), dtype=torch.float32) for key in KEYS}


def main(args: Args) -> list[float]:
    """Train an agent, and return the mean reward per step of every update."""
    torch.manual_seed(args.seed)
    torch.set_num_threads(1)
    vector: dict[str, object] = {"autoreset_mode": gym.vector.AutoresetMode.SAME_STEP}
    if args.processes:
        vector["context"] = "spawn"  # a forked process hangs if its parent has used numba threads
    options: dict[str, object] = {"preset": args.preset, "features": args.features}
    if args.frames is not None:
        options["frame_budget"] = args.frames
    envs = gym.make_vec(
        args.env_id,
        num_envs=args.num_envs,
        vectorization_mode="async" if args.processes else "sync",
        vector_kwargs=vector,
        wrappers=[lambda env: gym.wrappers.FilterObservation(env, list(KEYS))],
        **options,
    )
    space = envs.single_observation_space
    assert isinstance(space, gym.spaces.Dict)
    agent = Agent(space["candidate_features"].shape[-1], space["plane_features"].shape[-1])
    optimizer = torch.optim.Adam(agent.parameters(), lr=args.learning_rate, eps=1e-5)

    raw, _ = envs.reset(seed=args.seed)
    observation = tensors(raw)
    per_update, history, began = args.num_envs * args.num_steps, [], time.monotonic()
    for update in range(max(1, args.total_steps // per_update)):
        seen, actions, log_probs, rewards, dones, values = [], [], [], [], [], []
        for _ in range(args.num_steps):
            with torch.no_grad():
                distribution, value = agent(observation)
                action = distribution.sample()
            seen.append(observation)
            actions.append(action)
            log_probs.append(distribution.log_prob(action))
            values.append(value)
            raw, reward, terminated, truncated, _ = envs.step(action.numpy())
            observation = tensors(raw)
            rewards.append(torch.as_tensor(reward, dtype=torch.float32))
            # The budget is part of the observation. So its end is a termination, and no later value is added.
            dones.append(torch.as_tensor(terminated | truncated, dtype=torch.float32))

        with torch.no_grad():
            following, advantage = agent(observation)[1], torch.zeros(args.num_envs)
        advantages = [advantage] * args.num_steps
        for step in reversed(range(args.num_steps)):
            goes_on = 1.0 - dones[step]
            error = rewards[step] + args.gamma * following * goes_on - values[step]
            advantage = error + args.gamma * args.gae_lambda * goes_on * advantage
            advantages[step], following = advantage, values[step]

        batch = {key: torch.cat([one[key] for one in seen]) for key in KEYS}
        action, old, gained = torch.cat(actions), torch.cat(log_probs), torch.cat(advantages)
        returns = gained + torch.cat(values)
        for _ in range(args.update_epochs):
            for rows in torch.randperm(per_update).split(args.minibatch):
                distribution, value = agent({key: entry[rows] for key, entry in batch.items()})
                ratio = (distribution.log_prob(action[rows]) - old[rows]).exp()
                scaled = (gained[rows] - gained[rows].mean()) / (gained[rows].std(correction=0) + 1e-8)
                surrogate = torch.min(ratio * scaled, ratio.clamp(1 - args.clip, 1 + args.clip) * scaled).mean()
                error = (value - returns[rows]).square().mean()
                loss = -surrogate + args.value * error - args.entropy * distribution.entropy().mean()
                optimizer.zero_grad()
                loss.backward()
                nn.utils.clip_grad_norm_(agent.parameters(), args.max_grad_norm)
                optimizer.step()

        history.append(float(torch.stack(rewards).mean()))
        speed = (update + 1) * per_update / (time.monotonic() - began)
        print(f"update {update + 1}: reward per step {history[-1]:.3f}, {speed:.1f} steps/s", flush=True)
    envs.close()
    return history


if __name__ == "__main__":  # spawned processes import this file
    main(tyro.cli(Args))
