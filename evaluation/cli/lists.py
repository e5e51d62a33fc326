"""Define ``asg list``, which lists the names of policies, scenes, worlds, features and fields."""

# The module is not called list.py, since that name would hide the builtin ``list`` in the package.
from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import tyro

from activestructure_gym.evaluation.cli.config import Config
from activestructure_gym.evaluation.cli.features import Features
from activestructure_gym.evaluation.cli.policies import Policies
from activestructure_gym.evaluation.cli.scenes import Scenes
from activestructure_gym.evaluation.cli.worlds import Worlds


@tyro.conf.configure(tyro.conf.OmitArgPrefixes, tyro.conf.OmitSubcommandPrefixes)
@dataclass(frozen=True)
class List:
    """List policies, scenes, worlds, features or settings."""

    what: (
        Annotated[Policies, tyro.conf.subcommand("policies")]
        | Annotated[Scenes, tyro.conf.subcommand("scenes")]
        | Annotated[Worlds, tyro.conf.subcommand("worlds")]
        | Annotated[Features, tyro.conf.subcommand("features")]
        | Annotated[Config, tyro.conf.subcommand("config")]
    )
    """List these."""

    def run(self) -> int:
        """Print the list, and return 0."""
        return self.what.run()
