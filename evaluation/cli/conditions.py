"""Define the options that `asg compare` and `asg replay-trajectory` share.

One class has the options for the conditions of runs, the other the options for how runs are carried out.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.cli.fields import (
    Changes,
    Count,
    DryRun,
    Out,
    PathName,
    Switch,
    ViewSource,
    Words,
    option,
)
from activestructure_gym.evaluation.cli.options import parse_overrides, split_list

if TYPE_CHECKING:
    from activestructure_gym.evaluation.archive.conditions import Conditions


@dataclass(frozen=True)
class ConditionOptions:
    """Hold the options from which `Conditions` are made; an option that is not given is None or empty."""

    preset: Annotated[str | None, option("rl|fast|default|full|paper", "(default: default)")] = None
    """Start from this configuration; `asg list config PRESET` prints it."""
    frames: Count = None
    """Set the frame budget of every episode; by default the preset's, or all poses of a trajectory."""
    set: Changes = ()
    """Change the configuration (see `asg list config`), e.g. sensor.depth_noise=kinect mapper.iterations=8."""
    views: Annotated[int | None, option("N", "(default: 64)")] = None
    """Measure PSNR and SSIM on this number of held-out views."""
    view_source: Annotated[ViewSource | None, option("{free_space,recorded}", "(default: free_space)")] = None
    """Draw held-out views in the scene's free space, or take those recorded with the scene."""
    samples: Annotated[int | None, option("N", "(default: 200000)")] = None
    """Sample this number of points on the whole mesh; those visible from free space are the true surface."""
    protocols: Annotated[Words, option("NAME [NAME ...]", "(default: standard)")] = None
    """Measure by these protocols besides `standard`: activegamer, activesplat, naruto, offline."""
    metrics: Annotated[Words, option("NAME [NAME ...]", "")] = None
    """Measure finished maps by these metrics as well: registered names or package.module:Name."""
    lpips_weights: PathName = None
    """Read AlexNet's and LPIPS's weights from this folder; by default ASG_LPIPS_WEIGHTS or torch's hub cache."""

    def typed(self, begun: Conditions) -> dict[str, Any]:
        """Return the fields of `Conditions` for which the user gave options.

        The constants of the protocol that are not given are taken from ``begun``.
        """
        from activestructure_gym.config import known_preset

        overrides = parse_overrides(self.set)
        if self.frames is not None and "frame_budget" in overrides:
            budget = overrides["frame_budget"]
            raise InputError(f"--frames {self.frames} and --set frame_budget={budget}: leave one out")
        constants = {"views": self.views, "surface_samples": self.samples, "view_source": self.view_source}
        measured: dict[str, Any] = {name: value for name, value in constants.items() if value is not None}
        typed: dict[str, Any] = {
            "preset": None if self.preset is None else known_preset(self.preset),
            "frame_budget": self.frames,
            "overrides": overrides or None,
            "protocol": dataclasses.replace(begun.protocol, **measured) if measured else None,
        }
        if self.protocols is not None:
            typed["also"] = [name for name in split_list(self.protocols) if name != begun.protocol.name]
        if self.metrics is not None:
            typed["metrics"] = split_list(self.metrics)
        return {name: value for name, value in typed.items() if value is not None}


@dataclass(frozen=True)
class RunOptions:
    """Hold the options for the output directory and the engine of runs."""

    out: Out = None
    """Write the results into this directory; by default runs/<date>-<time>."""
    dry_run: DryRun = False
    """Print the runs, their frame budget and their directory, and write nothing."""
    resume: Switch = False
    (
        "Continue the comparison in --out under its stored conditions. Finished runs are kept; further scenes, "
        "policies and seeds are added."
    )
    engine: Annotated[str, option("local|inline|ray")] = "local"
    (
        "Run by local (one process per run, several at a time), inline (one after the other in this process) or ray "
        "(on a Ray cluster)."
    )
    workers: int = 0
    """Run this number of jobs at a time; 0 is one per core."""
    trust_code: Switch = False
    """Allow the execution of code (package.module:Name) named in a resumed comparison, a checkpoint or a run."""
