"""Define the options for episodes that all subcommands of ``asg train`` share."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from activestructure_gym.cores import core_count
from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.cli.fields import Changes, Count, DryRun, Out, PresetName, Switch, option
from activestructure_gym.evaluation.cli.options import use_trust
from activestructure_gym.evaluation.machine.threads import capped_environment


@dataclass(frozen=True)
class Episodes:
    """Hold the options for episodes: directory, processes, preset, frame budget and layouts."""

    out: Out = None
    """Write the results into this directory (default: runs/eval-<date>-<time>)."""
    dry_run: DryRun = False
    """Print what would run, and write nothing."""
    trust_code: Switch = False
    """Run code (package.module:Name) that files name: the record of --resume, a checkpoint."""
    workers: int = 0
    """Run this many processes at a time, 0 for one per core; results do not depend on it."""
    preset: PresetName = "fast"
    """Use the configuration that `asg list config PRESET` prints."""
    frames: Count = None
    """Stop every episode after this many frames (default: the preset's)."""
    set: Changes = ()
    """Change fields of the configuration (see `asg list config`), e.g. mapper.iterations=0."""
    rooms: Annotated[tuple[int, ...], option("N [N ...]")] = (1, 2, 3)
    """Use layouts with these numbers of rooms, in turn."""

    def begin(self) -> int:
        """Prepare this process before torch is loaded, and return the number of processes to use."""
        # One thread makes results reproducible, and small networks are not faster with two.
        os.environ.update(capped_environment(1))
        use_trust(self.trust_code)
        if self.workers < 0:
            raise InputError(f"--workers is a number of processes, or 0 for one per core, got {self.workers}")
        return self.workers or core_count()


def check_empty(directory: Path) -> None:
    """Raise `InputError` if the output is a file or a directory with files other than ``.lock``."""
    if directory.exists() and not directory.is_dir():
        raise InputError(f"the output '{directory}' is a file; give a directory")
    if directory.exists() and any(path.name != ".lock" for path in directory.iterdir()):
        raise InputError(f"'{directory}' holds other files: choose another --out")
