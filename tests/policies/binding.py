"""Policies on observations made by hand, whose columns are the gains they ask for and nothing else."""

from __future__ import annotations

from typing import TypeVar

from activestructure_gym.policies import Policy

P = TypeVar("P", bound=Policy)


def bound(policy: P) -> P:
    """The policy, told that the observation holds its own gains in its own order."""
    policy.bind(policy.required_gains)
    return policy
