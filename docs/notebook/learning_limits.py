"""Measure what limits PPO from a cloned network, on demonstrations that hold the gain of every candidate.

Usage: ``python docs/notebook/learning_limits.py RUN``, where RUN is the directory of an ``asg train bc`` run with its
demonstrations and references. The last sixth of the layouts is held out. Results are in learning.md, "Four hypotheses".
"""

from __future__ import annotations

import copy
import dataclasses
import json
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from activestructure_gym.evaluation.training import demonstrations
from activestructure_gym.evaluation.training.mirror import mirrored
from activestructure_gym.evaluation.training.rollout import play
from activestructure_gym.evaluation.training.runs import read_config
from activestructure_gym.evaluation.training.targets import soft_labels
from activestructure_gym.evaluation.training.training_env import learning_layouts, make_env
from activestructure_gym.evaluation.training.validation import network_choice
from activestructure_gym.ground_truth import Layout
from activestructure_gym.policies.learned.network import CandidateNetwork, as_tensors

Loss = Callable[[Tensor, Tensor, Tensor], Tensor]  # scores [B, K], values [B], numbers of the states [B] -> loss
GAMMAS = (0.0, 0.1, 0.3, 0.9, 1.0)
BATCHES = 6  # sampled gradients of 2,048 states each

torch.set_num_threads(1)
run = Path(sys.argv[1])
config = read_config(run)
data = demonstrations.load(config, Path(sys.argv[2]) if len(sys.argv) > 2 else run / demonstrations.DATA)
inputs, gains = as_tensors(data.observations), torch.as_tensor(data.scores)
valid, actions = inputs["action_mask"] > 0, torch.as_tensor(data.actions.astype(np.int64))
episode = np.concatenate([[0], np.cumsum(data.ends)[:-1]])
layout = episode // config.world.episodes_per_layout
bound = int(layout.max() + 1) * 5 // 6
learnt, held_out = (torch.as_tensor(np.flatnonzero(mask)) for mask in (layout < bound, layout >= bound))
shape = dataclasses.replace(config.network(), use_planes=False)  # the preset rl has no planes
targets = torch.as_tensor(
    soft_labels(data.scores.astype(np.float64), valid.numpy(), config.temperature), dtype=torch.float32
)


def states(rows: Tensor) -> dict[str, Tensor]:
    """Return the observations of some states."""
    return {name: value[rows] for name, value in inputs.items()}


def scores_of(network: CandidateNetwork, rows: Tensor) -> Tensor:
    """Return the scores of all candidates, in parts of 256 states."""
    with torch.no_grad():
        return torch.cat([network(states(part))[0] for part in rows.split(256)])


def shares(network: CandidateNetwork, rows: Tensor) -> str:
    """Format the gain of the best-scored and of a sampled candidate, where chance is 0 and the best candidate 1."""
    scores, gain = scores_of(network, rows), gains[rows]
    chance = (gain * valid[rows]).sum(1) / valid[rows].sum(1)
    greedy = gain.gather(1, scores.masked_fill(~valid[rows], -1e9).argmax(1, keepdim=True))[:, 0]
    sampled, span = (functional.softmax(scores, 1) * gain).sum(1), (gain.max(1)[0] - chance).sum()
    return " ".join(
        f"{name} {float((value - chance).sum() / span):.3f}" for name, value in (("best", greedy), ("sampled", sampled))
    )


def train(
    rows: Tensor, steps: int, loss: Loss, *, start: CandidateNetwork | None = None, rate: float = 1e-3, batch: int = 64
) -> CandidateNetwork:
    """Train a network; from nothing with cosine decay, from ``start`` with a constant learning rate."""
    torch.manual_seed(0)
    rng = np.random.default_rng(0)
    network = CandidateNetwork(shape) if start is None else copy.deepcopy(start)
    optimizer = torch.optim.AdamW(network.parameters(), lr=rate, weight_decay=config.weight_decay)
    for step in range(steps):
        for group in optimizer.param_groups:
            group["lr"] = rate if start is not None else 0.5 * rate * (1 + np.cos(np.pi * step / steps))
        chosen = rows[torch.as_tensor(rng.integers(len(rows), size=batch))]
        scores, values = network(mirrored(states(chosen), torch.as_tensor(rng.random(batch) < 0.5)))
        optimizer.zero_grad()
        loss(scores, values, chosen).backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimizer.step()
    return network


def cloning(scores: Tensor, values: Tensor, rows: Tensor) -> Tensor:
    """Return the loss of behaviour cloning."""
    return -(targets[rows] * functional.log_softmax(scores, 1)).sum(1).mean()


def exact(scores: Tensor, values: Tensor, rows: Tensor) -> Tensor:
    """Return the negative expected gain: the objective of PPO for one step, without any sampling noise."""
    return -(functional.softmax(scores, 1) * gains[rows]).sum(1).mean() / float(gains.max(1)[0].mean())


def value_of_actions(gamma: float) -> Loss:
    """Return the loss of a regression of the discounted return on the action that was taken."""
    returns = torch.as_tensor(data.returns(gamma), dtype=torch.float32)

    def loss(scores: Tensor, values: Tensor, rows: Tensor) -> Tensor:
        taken = scores.gather(1, actions[rows][:, None])[:, 0]
        return functional.mse_loss(taken / 5 + values, returns[rows]) / float(returns.var())

    return loss


def noise(network: CandidateNetwork) -> None:
    """Print how many steps a gradient needs, for several discount factors."""
    rows = learnt[torch.as_tensor(np.random.default_rng(0).permutation(len(learnt))[:2048])]
    chances = torch.cat([functional.softmax(scores_of(network, part), 1) for part in rows.split(256)])
    value, draw = (chances * gains[rows]).sum(1), torch.Generator().manual_seed(0)
    parameters = [parameter for name, parameter in network.named_parameters() if not name.startswith("critic.")]

    def gradient(weights: Tensor) -> Tensor:
        total = 0.0
        for part, own in zip(rows.split(256), weights.split(256)):
            chosen = (own * functional.log_softmax(network(states(part))[0], 1)).sum() / len(rows)
            found = torch.autograd.grad(chosen, parameters, allow_unused=True)
            flat = [(torch.zeros_like(p) if g is None else g).flatten() for p, g in zip(parameters, found)]
            total = total + torch.cat(flat)
        return total

    truth = float(gradient(chances * (gains[rows] - value[:, None])).norm() ** 2)
    known = torch.cat([
        inputs["budget"], (inputs["candidate_features"] * valid[..., None]).amax(1), valid.sum(1, keepdim=True),
        gains.max(1)[0][:, None], torch.ones(len(data), 1),
    ], 1).double()  # fmt: skip
    taken = gains.gather(1, actions[:, None])[:, 0].numpy()
    unit = float(np.polyfit(taken, data.rewards, 1)[0])  # reward per gain
    for gamma in GAMMAS:
        returns = torch.as_tensor(data.returns(gamma))[:, None]
        left = float((returns - known @ torch.linalg.lstsq(known, returns).solution).std())
        found = []
        for _ in range(BATCHES):
            row = torch.multinomial(chances, 1, generator=draw)
            extra = left / unit * torch.randn(len(rows), generator=draw)
            advantage = gains[rows].gather(1, row)[:, 0] - value + extra
            found.append(gradient(torch.zeros_like(chances).scatter(1, row, advantage[:, None])))
        scale = float(torch.stack(found).var(0).sum()) * len(rows) / truth
        print(f"gamma {gamma}: noise scale {scale:.0f} steps, cosine at 1,024 steps {(1 + scale / 1024) ** -0.5:.2f}")


def on_validation_layouts(networks: dict[str, CandidateNetwork]) -> None:
    """Print the normalised area of every network on the validation layouts, and its difference from the first."""
    references = json.loads((run / "references.json").read_text(encoding="utf-8"))
    low, high = np.array(references["random"]), np.array(references["oracle"])
    areas: dict[str, list[float]] = {name: [] for name in networks}
    for number, spec in enumerate(learning_layouts(config.world, "validation", len(low))):
        truth = Layout(spec).truth()
        for name, network in networks.items():
            areas[name].append(play(make_env(config.world, truth), network_choice(network), 1000 + number).auc)
    draws = np.random.default_rng(0).integers(len(low), size=(2000, len(low)))
    base, span = np.array(areas[next(iter(areas))]), high - low
    for name, played in areas.items():
        texts = []
        for numbers in (np.array(played) - low, np.array(played) - base):
            ends = np.percentile(numbers[draws].mean(1) / span[draws].mean(1), [2.5, 97.5])
            texts.append(f"{numbers.mean() / span.mean():+.3f} [{ends[0]:+.3f}, {ends[1]:+.3f}]")
        print(f"{name}: {texts[0]}, minus cloned {texts[1]}")


if __name__ == "__main__":
    for count in (50, 100, bound):
        rows = torch.as_tensor(np.flatnonzero(layout < count))
        cloned = train(rows, 1300, cloning)
        print(f"cloned from {count} layouts: held out {shares(cloned, held_out)}; own {shares(cloned, rows)}")
    noise(cloned)
    more = {"rate": 3e-4, "batch": 128}
    networks = {
        "cloned": cloned,
        "exact gradient": train(learnt, 600, exact, start=cloned, **more),  # type: ignore[arg-type]
        "cloned 600 steps more": train(learnt, 600, cloning, start=cloned, **more),  # type: ignore[arg-type]
        **{f"values, gamma {g}": train(learnt, 600, value_of_actions(g), start=cloned, **more) for g in (0.0, 0.9)},  # type: ignore[arg-type]
    }
    for name, network in networks.items():
        print(f"{name}: held out {shares(network, held_out)}")
    on_validation_layouts(networks)
