"""Train on demonstrations of an expert: behaviour cloning with soft labels, or ranking with ordinal targets."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from activestructure_gym.evaluation.training.config import TrainingConfig
from activestructure_gym.evaluation.training.demonstrations import Demonstrations
from activestructure_gym.evaluation.training.mirror import mirrored
from activestructure_gym.evaluation.training.runs import (
    TrainingRun,
    module_tensors,
    optimizer_tensors,
)
from activestructure_gym.evaluation.training.targets import bin_edges, ordinal, soft_labels, standardised
from activestructure_gym.policies.learned.network import CandidateNetwork, as_tensors

Validate = Callable[[CandidateNetwork], Mapping[str, float]]  # scores a network; returns entries of a log row
Notify = Callable[[int, Mapping[str, float]], None]  # called with the number of finished units and the log row

_CRITIC_WEIGHT = 0.5  # weight of the critic's squared error in the loss; its gradients reach only the critic


class OrdinalRanks(nn.Module):
    """Compute the CORAL loss of ordinal ranks ([cao2020]): P(rank > k) = sigmoid(score + b_k) with thresholds b_k.

    All thresholds share one score, so P(rank > k) falls with k if b_k does.
    """

    def __init__(self, bins: int) -> None:
        super().__init__()
        # With these thresholds, a score of 0 gives every rank the same probability.
        above = 1.0 - torch.arange(1, bins) / bins
        self.thresholds = nn.Parameter(torch.log(above / (1.0 - above)))  # [bins - 1]

    def forward(self, scores: Tensor, ranks: Tensor) -> Tensor:  # [M], [M] int64 -> scalar
        """Return the loss of M scores and their ranks: cross-entropy, summed over thresholds, averaged over scores."""
        above = (ranks[:, None] > torch.arange(len(self.thresholds))).to(scores.dtype)
        logits = scores[:, None] + self.thresholds
        return functional.binary_cross_entropy_with_logits(logits, above, reduction="none").sum(1).mean()


def train_supervised(
    config: TrainingConfig, data: Demonstrations, run: TrainingRun, validate: Validate, notify: Notify = lambda *_: None
) -> CandidateNetwork:
    """Train a network on ``data`` from the first unfinished epoch of ``run`` to the last, and return the network.

    ``validate`` scores a network, and ``notify`` is called with the number of finished epochs and the log row.
    """
    torch.manual_seed(config.seed)
    model = nn.ModuleDict({"network": CandidateNetwork(config.network())})
    if config.method == "rank":
        model["ranks"] = OrdinalRanks(config.bins)
    network = model["network"]
    assert isinstance(network, CandidateNetwork)
    optimizer = torch.optim.AdamW(model.parameters(), lr=config.rate, weight_decay=config.weight_decay)
    if run.tensors:
        run.restore(model, optimizer)

    inputs = as_tensors(data.observations)
    targets, returns = _targets(config, data), torch.as_tensor(data.returns(config.gamma), dtype=torch.float32)
    best = torch.as_tensor(data.scores).argmax(1)
    batches = -(-len(data) // config.batch)
    run.timing.switch("updating")
    while not run.ended:
        epoch, sums = run.position, dict.fromkeys(("train/loss", "train/critic_loss", "train/agreement"), 0.0)
        rng = np.random.default_rng([config.seed, epoch])
        order, in_mirror = rng.permutation(len(data)), torch.as_tensor(rng.random(len(data)) < 0.5)
        for number, chosen in enumerate(np.array_split(order, batches)):
            for group in optimizer.param_groups:
                group["lr"] = _cosine(config.rate, (epoch + number / batches) / config.epochs)
            rows = torch.as_tensor(chosen)
            states = {key: value[rows] for key, value in inputs.items()}
            scores, values = network(mirrored(states, in_mirror[rows]) if config.mirror else states)
            valid = inputs["action_mask"][rows] > 0
            if config.method == "rank":
                loss = model["ranks"](scores[valid], targets[rows][valid])
            else:
                loss = -(targets[rows] * functional.log_softmax(scores, dim=1)).sum(1).mean()
            critic = functional.mse_loss(values, returns[rows])
            optimizer.zero_grad()
            (loss + _CRITIC_WEIGHT * critic).backward()
            nn.utils.clip_grad_norm_(model.parameters(), 1.0)
            optimizer.step()
            share = len(rows) / len(data)
            sums["train/loss"] += float(loss.detach()) * share
            sums["train/critic_loss"] += float(critic.detach()) * share
            sums["train/agreement"] += float((scores.argmax(1) == best[rows]).float().mean()) * share
        run.timing.count("updating", len(data))
        row: dict[str, Any] = dict(sums)
        if (epoch + 1) % config.validate_every == 0 or epoch + 1 == config.epochs:
            run.timing.switch("validating")
            row |= validate(network)
            run.timing.switch("updating")
        run.finish_unit(row, network, module_tensors(model) | optimizer_tensors(optimizer))
        notify(run.position, row)
    return network


def _targets(config: TrainingConfig, data: Demonstrations) -> Tensor:  # [N, K]
    valid = data.observations["action_mask"] > 0
    scores = data.scores.astype(np.float64)
    if config.method == "bc":
        return torch.as_tensor(soft_labels(scores, valid, config.temperature), dtype=torch.float32)
    heights = standardised(scores, valid)
    return torch.as_tensor(ordinal(heights, bin_edges(heights[valid], config.bins)))


def _cosine(rate: float, share: float) -> float:
    return 0.5 * rate * (1.0 + math.cos(math.pi * share))
