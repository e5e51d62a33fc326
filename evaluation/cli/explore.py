"""Define ``asg explore``, which explores a world: a simulator, a recording or a robot."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.archive.store import COMPARISON
from activestructure_gym.evaluation.cli.compare import Compare, compare_with, resuming
from activestructure_gym.evaluation.cli.fields import Changes, Count, DryRun, Out, Switch, option
from activestructure_gym.policies.native_settings import Setup
from activestructure_gym.streams import complain
from activestructure_gym.worlds.registry import PREFIX


@dataclass(frozen=True)
class Explore:
    """Explore a simulated, real or recorded scene.

    The result is a run with map, path and report, as of `asg compare`. Every captured frame is stored, so --resume
    continues an episode that was stopped. `asg watch --world` shows an episode in a browser.
    """

    world: Annotated[str | None, option("WORLD", "")] = None
    (
        "Explore this world: a name (see `asg list worlds`) or package.module:factory, with options after a "
        "question mark (simulated?scene=apartment). With any world, tries=N tries a capture up to N times, and "
        "timeout_s=T limits its time in seconds."
    )
    policy: Annotated[str, option("NAME")] = "activestructure"
    """Explore with this policy (see `asg list policies`)."""
    frames: Count = None
    """Stop after this many frames (default: the preset's)."""
    seed: Annotated[int | None, option("N", "(default: 0)")] = None
    """Set the random seed of planner and map, and of a simulator."""
    preset: Annotated[str | None, option("rl|fast|default|full|paper", "(default: default)")] = None
    """Start from this configuration; `asg list config PRESET` prints it."""
    setup: Annotated[Setup | None, option("{shared,native}", "(default: shared)")] = None
    """Use the common candidates, keyframes and mapper (shared), or the planner's own (native)."""
    set: Changes = ()
    """Change fields of the configuration (see `asg list config`)."""
    out: Out = None
    """Write the results into this directory; by default runs/<date>-<time>."""
    resume: Switch = False
    """Continue the episode in --out; frames that were stored are not captured again."""
    replay: Switch = False
    """Write replay.html, a page to watch."""
    dry_run: DryRun = False
    """Print what would be explored, and write nothing."""
    trust_code: Switch = False
    """Run code that the record of --resume names as package.module:factory."""

    def run(self) -> int:
        """Explore the world; return 0 if the episode ended, 1 if it failed, 130 if it was stopped."""
        if self.world is None and not self.resume:
            raise InputError("--world names the world to explore, for example --world simulated")
        if self.resume and self.world is None and not (self.out and (Path(self.out) / COMPARISON).is_file()):
            raise InputError("--resume continues the run in --out, and there is none: check --out, or give --world")
        directory = self.out or time.strftime("runs/%Y%m%d-%H%M%S")
        asked = Compare(
            scenes=() if self.world is None else (PREFIX + self.world.removeprefix(PREFIX),),
            policies=None if self.resume and self.world is None else (self.policy,),
            seeds=None if self.seed is None else (str(self.seed),),
            preset=self.preset,
            frames=self.frames,
            setup=self.setup,
            set=self.set,
            out=directory,
            resume=self.resume,
            replay=self.replay,
            dry_run=self.dry_run,
            trust_code=self.trust_code,
            engine="inline",
        )
        code = compare_with(asked, command="asg explore")
        if code == 1 and any(Path(directory).glob("captures/*/*.npz")):
            from activestructure_gym.evaluation.running.resuming import recorded_jobs

            again = resuming("asg explore", Path(directory), recorded_jobs(Path(directory)))
            complain(f"captured frames are kept; continue with: {again}")
        return code
