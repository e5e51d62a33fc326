"""Policies on observations made by hand, whose columns are the features they ask for and nothing else."""

from __future__ import annotations

from typing import TypeVar

from activestructure_gym.features import column_names
from activestructure_gym.policies import Policy

P = TypeVar("P", bound=Policy)


def columns(policy: Policy | type[Policy]) -> tuple[str, ...]:
    """The columns of the features it asks for."""
    return column_names(policy.required_features)


def bound(policy: P) -> P:
    """The policy, told that the observation holds its own features in its own order."""
    policy.bind(columns(policy))
    return policy
