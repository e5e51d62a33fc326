"""Define the policies of trained networks: ``learned:CHECKPOINT``, and ``learned`` for the package's checkpoint."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from activestructure_gym.envs.observation import plane_columns
from activestructure_gym.errors import InputError
from activestructure_gym.policies.base import POLICIES, Observation, Policy, best_valid
from activestructure_gym.policies.learned.checkpoint import (
    digest,
    find_checkpoint,
    load_network,
    read_network_config,
    weights_at,
)
from activestructure_gym.policies.learned.config import USED_KEYS

if TYPE_CHECKING:
    from activestructure_gym.policies.learned.network import CandidateNetwork

SHIPPED = Path(__file__).resolve().parent / "checkpoints" / "learned.safetensors"


class Learned(Policy):
    """Choose argmax f(row, all rows, planes), where f is the score of a trained network, without random choices.

    `learned_from` creates a subclass for each checkpoint, since the class defines the required features.
    """

    criterion = "score of a small network over all candidates"
    travel_term = "an input"
    source = "this project"

    checkpoint: ClassVar[Path]
    spec: ClassVar[str]

    def __init__(self) -> None:
        super().__init__()
        self._network: CandidateNetwork | None = None
        self._trace: dict[str, Any] = {}

    @property
    def network(self) -> CandidateNetwork:
        """Return the network; the first call loads it."""
        if self._network is None:
            self._network = load_network(self.checkpoint)
        return self._network

    def scores(self, observation: Observation) -> np.ndarray:  # [K]
        """Return the network's score of every candidate; -1e8 in rows without one."""
        import torch

        from activestructure_gym.policies.learned.network import as_tensors

        candidates = self.candidates(observation)
        features = np.stack([candidates[name] for name in self.required_features], axis=-1)
        observation = largest_planes(observation, self.network.config.max_planes)
        entries = {key: observation[key][None] for key in USED_KEYS} | {"candidate_features": features[None]}
        with torch.no_grad():
            return self.network(as_tensors(entries))[0][0].numpy()

    def act(self, observation: Observation) -> int:
        """Return the valid row with the highest score; the first of equal ones."""
        best_valid(np.zeros(len(self.candidates(observation))), observation)  # raises before torch is loaded
        scores = self.scores(observation)
        choice = best_valid(scores, observation)
        valid = scores[observation["action_mask"].astype(bool)]
        self._trace = {"score": float(scores[choice]), "above_mean": float(scores[choice] - valid.mean())}
        return choice

    def trace(self) -> dict[str, Any]:
        """Return the chosen view's score, and its difference from the mean score of the valid views."""
        return self._trace

    def __reduce__(self) -> tuple[Any, ...]:
        # The class is created at run time, so a pickle stores its spec. The weights are loaded again when needed.
        return _from_spec, (self.spec,), {**self.__dict__, "_network": None}


def largest_planes(observation: Observation, count: int) -> Observation:
    """Return a copy of the observation with the ``count`` largest planes, or the observation if it has no more rows."""
    (area,) = plane_columns("area")
    table = observation["plane_features"]
    if len(table) <= count:
        return observation
    rows = np.sort(np.argsort(-table[:, area], kind="stable")[:count])
    return {
        **observation,
        "plane_features": table[rows],
        "plane_mask": observation["plane_mask"][rows],
        "plane_edges": observation["plane_edges"][np.ix_(rows, rows)],
        "candidate_planes": observation["candidate_planes"][:, rows],
    }


def _from_spec(spec: str) -> Policy:
    return POLICIES.get(spec)()


@POLICIES.register_family("learned")
def learned_from(place: str) -> type[Learned]:
    """Return the policy class of a checkpoint.

    ``place`` is ``FILE.safetensors``, ``FILE`` or a training run's directory. ``FILE@1a2b3c4d`` also requires the hash
    of its content. Raises `InputError` if the checkpoint is missing or has another hash.
    """
    path, at, expected = place.rpartition("@")
    if not at or len(expected) != 8 or Path(os.path.expanduser(place)).exists() or weights_at(place).is_file():
        path, expected = place, ""
    weights = find_checkpoint(path).resolve()
    found = digest(weights)
    if expected and expected != found:
        raise InputError(f"the checkpoint '{path}' has changed: expected {expected}, found {found}")
    return _policy_of(weights, f"learned:{weights}@{found}")


def _policy_of(weights: Path, spec: str) -> type[Learned]:
    """Create the policy class of the checkpoint with the file ``weights``; ``spec`` is its canonical name."""
    attributes = {
        "checkpoint": weights,
        "spec": spec,
        "required_features": read_network_config(weights).features,
        "__module__": __name__,  # the default would be "abc"
        "__doc__": Learned.__doc__,
    }
    return type("Learned", (Learned,), attributes)


if SHIPPED.is_file():
    POLICIES.register("learned")(_policy_of(SHIPPED, "learned"))
