"""A trained network as a policy like any other: ``learned:CHECKPOINT`` in every command, ``learned`` for our own."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from activestructure_gym.errors import InputError
from activestructure_gym.policies.base import POLICIES, Observation, Policy, best_valid
from activestructure_gym.policies.learned.checkpoint import digest, find_checkpoint, load_network, read_network_config
from activestructure_gym.policies.learned.config import USED_KEYS

if TYPE_CHECKING:
    from activestructure_gym.policies.learned.network import CandidateNetwork

SHIPPED = Path(__file__).resolve().parent / "checkpoints" / "learned.safetensors"


class Learned(Policy):
    """row* = argmax f(row, all rows, planes), f the score of the network; no random choice, no state between steps.

    A class for each checkpoint, made by `learned_from`, since an env is told by the class which features to evaluate.
    """

    criterion = "the score of a small network over all candidates"
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
        """Loaded by the first decision."""
        if self._network is None:
            self._network = load_network(self.checkpoint)
        return self._network

    def scores(self, observation: Observation) -> np.ndarray:  # [K]
        """The network's score of every candidate; very low in rows without one."""
        import torch

        from activestructure_gym.policies.learned.network import as_tensors

        candidates = self.candidates(observation)
        features = np.stack([candidates[name] for name in self.required_features], axis=-1)
        entries = {key: observation[key][None] for key in USED_KEYS} | {"candidate_features": features[None]}
        with torch.no_grad():
            return self.network(as_tensors(entries))[0][0].numpy()

    def act(self, observation: Observation) -> int:
        """The valid row with the highest score; the first of equals."""
        best_valid(np.zeros(len(self.candidates(observation))), observation)  # before torch is loaded for nothing
        scores = self.scores(observation)
        choice = best_valid(scores, observation)
        valid = scores[observation["action_mask"].astype(bool)]
        self._trace = {"score": float(scores[choice]), "above_mean": float(scores[choice] - valid.mean())}
        return choice

    def trace(self) -> dict[str, Any]:
        """The chosen view's score, and how far it stood above the mean of all."""
        return self._trace

    def __reduce__(self) -> tuple[Any, ...]:
        # The class is made at run time: it travels by name, and the weights are read again there.
        return _again, (self.spec,), {**self.__dict__, "_network": None}


def _again(spec: str) -> Policy:
    return POLICIES.get(spec)()


@POLICIES.register_family("learned")
def learned_from(place: str) -> type[Learned]:
    """The policy of a checkpoint: ``FILE.safetensors``, the same without an ending, or a training run's directory.

    ``FILE@1a2b3c4d`` says which content is meant. Raises `InputError` if it is not there, or another one.
    """
    path, at, expected = place.rpartition("@")
    if not at or len(expected) != 8 or Path(os.path.expanduser(place)).exists():
        path, expected = place, ""
    weights = find_checkpoint(path).resolve()
    found = digest(weights)
    if expected and expected != found:
        raise InputError(f"the checkpoint '{path}' has changed: expected {expected}, found {found}")
    return _policy_of(weights, f"learned:{weights}@{found}")


def _policy_of(weights: Path, spec: str) -> type[Learned]:
    features = read_network_config(weights).features
    about = {
        "checkpoint": weights,
        "spec": spec,
        "required_features": features,
        "__module__": __name__,
    }  # else it is "abc"
    about["__doc__"] = Learned.__doc__
    return type("Learned", (Learned,), about)


if SHIPPED.is_file():
    POLICIES.register("learned")(_policy_of(SHIPPED, "learned"))
