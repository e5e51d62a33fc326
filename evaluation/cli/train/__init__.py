"""``asg train``: train a policy by one of several methods, or score policies."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import tyro

from activestructure_gym.evaluation.cli.train.methods import Bc, Ppo, Rank
from activestructure_gym.evaluation.cli.train.score import Score


@tyro.conf.configure(tyro.conf.OmitArgPrefixes, tyro.conf.OmitSubcommandPrefixes)
@dataclass(frozen=True)
class Train:
    """Train a learned policy on procedural apartments, or score policies on layouts nobody was trained on.

    Their options: asg train bc --help, and so on. PPO begins best from a checkpoint of bc.
    """

    method: (
        Annotated[Bc, tyro.conf.subcommand("bc")]
        | Annotated[Rank, tyro.conf.subcommand("rank")]
        | Annotated[Ppo, tyro.conf.subcommand("ppo")]
        | Annotated[Score, tyro.conf.subcommand("score")]
    )
    """The method, or score."""

    def run(self) -> int:
        """0 when done, 1 if nothing came of it, 130 if stopped."""
        return self.method.run()
