"""``asg bench``: how fast the parts are here, what they find, how good maps are; each with options of its own."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import tyro

from activestructure_gym.evaluation.cli.bench.decisions import Decisions
from activestructure_gym.evaluation.cli.bench.episodes import Env, Evaluation, Grid, Policies
from activestructure_gym.evaluation.cli.bench.maps import Growth, Mapping
from activestructure_gym.evaluation.cli.bench.parts import Planes, Sensor, Splatting


@tyro.conf.configure(tyro.conf.OmitArgPrefixes, tyro.conf.OmitSubcommandPrefixes)
@dataclass(frozen=True)
class Bench:
    """Measure a part on this machine, and print what was measured."""

    part: (
        Annotated[Sensor, tyro.conf.subcommand("sensor")]
        | Annotated[Splatting, tyro.conf.subcommand("splatting")]
        | Annotated[Planes, tyro.conf.subcommand("planes")]
        | Annotated[Mapping, tyro.conf.subcommand("mapping")]
        | Annotated[Growth, tyro.conf.subcommand("growth")]
        | Annotated[Grid, tyro.conf.subcommand("grid")]
        | Annotated[Evaluation, tyro.conf.subcommand("evaluation")]
        | Annotated[Policies, tyro.conf.subcommand("policies")]
        | Annotated[Env, tyro.conf.subcommand("env")]
        | Annotated[Decisions, tyro.conf.subcommand("decisions")]
    )
    """The part to measure."""

    def run(self) -> int:
        """Measure and print."""
        return self.part.run()
