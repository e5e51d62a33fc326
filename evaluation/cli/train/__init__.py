"""``asg train``: train a policy by one of several methods, or evaluate policies."""

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

    Layouts are procedural apartments; evaluation uses others than training. Start ppo from a checkpoint of bc. The
    options of a method are printed by its own help, as asg train bc --help.
    """

    method: (
        Annotated[Bc, tyro.conf.subcommand("bc")]
        | Annotated[Rank, tyro.conf.subcommand("rank")]
        | Annotated[Ppo, tyro.conf.subcommand("ppo")]
        | Annotated[Eval, tyro.conf.subcommand("eval")]
    )
    """Train by this method, or evaluate."""

    def run(self) -> int:
        """0 when done, 1 if nothing came of it, 130 if stopped."""
        return self.method.run()
