"""Define the candidate-set network: one score per candidate view, and a value of the state.

The same small head is applied to every row of the candidate table. In training, it reaches the performance of a greedy
expert within a few thousand steps. A flat network over the table learns nothing, because rows change their order in
every step (docs/notebook/lab_notes.md). Planes pass messages along the edges of the Plane Scene Graph, and a candidate
gets the messages of the planes it would see. Scores are equivariant to permutations of candidates and invariant to
permutations of planes.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch
from torch import Tensor, nn

from activestructure_gym.policies.learned import inputs
from activestructure_gym.policies.learned.config import PLANE_KEYS, USED_KEYS, NetworkConfig

MASKED = -1e8  # score of a row without a candidate; finite, to keep entropies finite


def masked_pool(tokens: Tensor, mask: Tensor) -> Tensor:  # [B, N, C], [B, N] -> [B, 2 C]
    """Return mean and maximum of ``tokens`` over the N rows with mask 1; 0 if there is none."""
    weights = mask[..., None]
    mean = (tokens * weights).sum(1) / weights.sum(1).clamp(min=1.0)
    most = torch.where(weights > 0, tokens, tokens.new_full((), -torch.inf)).amax(1)
    return torch.cat([mean, torch.where(most.isfinite(), most, torch.zeros_like(most))], dim=-1)


def _head(inputs: int, width: int) -> nn.Sequential:
    """Return a network of two layers from ``inputs`` channels over ``width`` channels to one output.

    The output is initially near 0, so that all candidates are about equally likely.
    """
    last = nn.Linear(width, 1)
    nn.init.normal_(last.weight, std=0.01)
    nn.init.zeros_(last.bias)
    return nn.Sequential(nn.Linear(inputs, width), nn.ReLU(), last)


class CandidateNetwork(nn.Module):
    """Compute scores of candidates and the value of the state from batches of observations (`USED_KEYS`)."""

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__()
        self.config = config
        planes, width, features = config.planes, config.candidates, len(config.features)
        self.plane_in = nn.Linear(inputs.PLANE_INPUTS, planes)
        self.rounds = nn.ModuleList(nn.Linear(2 * planes, planes) for _ in range(config.rounds))
        rows_in = nn.Linear(inputs.CANDIDATE_INPUTS + inputs.INPUTS_PER_FEATURE * features + planes, width)
        with torch.no_grad():
            rows_in.weight[:, list(inputs.CONSTANT_IF_FAST)] = 0.0
        self.candidate_in = nn.Sequential(rows_in, nn.ReLU(), nn.Linear(width, width), nn.ReLU())
        pooled = 2 * width + 2 * planes + inputs.GLOBAL_INPUTS + features
        self.context = nn.Sequential(nn.Linear(pooled, width), nn.ReLU())
        self.scorer = _head(2 * width, width)
        self.critic = _head(pooled, width)

    def forward(self, observation: Mapping[str, Tensor]) -> tuple[Tensor, Tensor]:  # [B, K], [B]
        """Return the scores of B x K candidates, `MASKED` in rows without a candidate, and the values of B states.

        Gradients of the critic do not reach the shared layers. An untrained critic therefore does not change a policy
        that starts from a copied expert.
        """
        if not self.config.use_planes:
            observation = {**observation, **{key: torch.zeros_like(observation[key]) for key in PLANE_KEYS}}
        valid, present = observation["action_mask"], observation["plane_mask"]
        links = inputs.plane_links(observation)
        planes = torch.relu(self.plane_in(inputs.plane_inputs(observation)))
        for layer in self.rounds:
            planes = torch.relu(layer(torch.cat([planes, links @ planes], dim=-1)))
        planes = planes * present[..., None]
        seen = observation["candidate_planes"]
        summary = seen @ planes / (1.0 + seen.sum(-1, keepdim=True))  # [B, K, planes]
        tokens = self.candidate_in(torch.cat([inputs.candidate_inputs(observation), summary], dim=-1))
        pooled = torch.cat(
            [masked_pool(tokens, valid), masked_pool(planes, present), inputs.global_inputs(observation)], dim=-1
        )
        context = self.context(pooled)[:, None].expand_as(tokens)
        scores = self.scorer(torch.cat([tokens, context], dim=-1)).squeeze(-1)
        value = self.critic(pooled.detach()).squeeze(-1)
        return torch.where(valid > 0, scores, scores.new_full((), MASKED)), value


def as_tensors(observations: Mapping[str, np.ndarray]) -> dict[str, Tensor]:
    """Return the entries that the network reads as float32 tensors; arrays need a leading batch axis."""
    return {key: torch.as_tensor(np.asarray(observations[key]), dtype=torch.float32) for key in USED_KEYS}
