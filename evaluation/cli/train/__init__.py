"""Define ``asg train``, which trains a policy by one of several methods, or evaluates policies."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import tyro

from activestructure_gym.evaluation.cli.train.eval import Eval
from activestructure_gym.evaluation.cli.train.methods import Bc, Ppo, Rank


@tyro.conf.configure(tyro.conf.OmitArgPrefixes, tyro.conf.OmitSubcommandPrefixes)
@dataclass(frozen=True)
class Train:
    """Train a learned policy, or evaluate policies.

    Layouts are procedural apartments; training and evaluation use different ones. ppo is best started from a checkpoint
    of bc. Every method has its own help, as asg train bc --help.
    """

    method: (
        Annotated[Bc, tyro.conf.subcommand("bc")]
        | Annotated[Rank, tyro.conf.subcommand("rank")]
        | Annotated[Ppo, tyro.conf.subcommand("ppo")]
        | Annotated[Eval, tyro.conf.subcommand("eval")]
    )
    """Train by this method, or evaluate."""

    def run(self) -> int:
        """Run the method; return 0 if it finished, 1 if it has no checkpoint, 130 if stopped."""
        return self.method.run()
