"""Define ``asg train eval``, which evaluates checkpoints and planners on held-out layouts."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from activestructure_gym.errors import InputError, listed
from activestructure_gym.evaluation.cli.fields import Names, NoNames, option
from activestructure_gym.evaluation.cli.options import parse_overrides, parse_seeds, split_policies, split_scenes
from activestructure_gym.evaluation.cli.output import make_console, plain_table, print_whole
from activestructure_gym.evaluation.cli.train.common import Episodes, check_empty
from activestructure_gym.evaluation.cli.train.live import Live
from activestructure_gym.streams import escape

_BASELINE = "pixel_only"


@dataclass(frozen=True)
class Eval(Episodes):
    """Evaluate policies on held-out layouts, between random (0) and the one-step oracle (1)."""

    layouts: int = 24
    """Play on this many procedural apartments, one episode each."""
    policies: Names = ("pixel_only", "hole_area")
    """Evaluate these, with random and the one-step oracle."""
    scenes: Annotated[tuple[str, ...], option("SCENE [SCENE ...]", "")] = ()
    """Add these scenes, each with one episode per seed."""
    seeds: Annotated[tuple[str, ...], option("N [N ...]", "(default: 0 to 19)")] = tuple(str(n) for n in range(20))
    """Set the seeds of the episodes on --scenes; each episode has the scene's next start pose."""
    baselines: NoNames = ()
    """Add a column of differences from each of these (default: pixel_only, if it is among --policies)."""

    def run(self) -> int:
        """Play the episodes that the directory lacks, then print and write the table."""
        workers = self.begin()

        from activestructure_gym.config import known_preset
        from activestructure_gym.evaluation.archive.directory_lock import hold
        from activestructure_gym.evaluation.archive.temporary import writing
        from activestructure_gym.evaluation.training import scoring
        from activestructure_gym.evaluation.training.config import WorldConfig
        from activestructure_gym.evaluation.training.training_env import world_config
        from activestructure_gym.files import replaced
        from activestructure_gym.policies import canonical_policy, make_policy
        from activestructure_gym.scenes.library import check_scene_name

        console = make_console()
        policies = [canonical_policy(name) for name in split_policies(self.policies)]
        asked = self.baselines or tuple(name for name in policies if name == _BASELINE)
        baselines = [canonical_policy(name) for name in split_policies(asked)]
        for baseline in baselines:
            if baseline not in (*policies, scoring.RANDOM):
                raise InputError(f"--baselines are among the policies, {listed(policies)}; got '{baseline}'")
        world = WorldConfig(
            rooms=self.rooms, preset=known_preset(self.preset), frames=self.frames, noise=False, features=(),
            overrides=tuple(parse_overrides(self.set).items()),
        )  # fmt: skip
        for name in policies:
            world_config(world, tuple(make_policy(name).required_features))
        scenes = split_scenes(self.scenes)
        for scene in scenes:
            check_scene_name(scene)
        cells = scoring.cells(self.layouts, world.rooms, scenes, parse_seeds(self.seeds))
        directory = Path(self.out or time.strftime("runs/eval-%Y%m%d-%H%M%S"))
        if not (directory / scoring.RECORD).is_file():
            check_empty(directory)
        frames = world_config(world).frame_budget
        what = f"{len(policies) + 2} policies x {len(cells)} episodes of {frames} frames, preset {world.preset}"
        if self.dry_run:
            console.print(f"{what}, {workers} processes, into {escape(str(directory))}: nothing was run (--dry-run)")
            return 0
        with hold(directory), Live(console) as live:
            live.begin("episodes", len(cells), 0)
            live.say(f"{len(policies) + 2} policies each, {workers} at a time")
            scoring.play_cells(world, policies, cells, directory, workers=workers, notify=live.files)
        rows = scoring.table(directory, policies, cells, baselines)
        with writing(directory), replaced(directory / "eval.md") as file:
            file.write(scoring.markdown(rows, baselines).encode())
        shown = plain_table(
            "mean coverage over the budget; normalised: 0 = random, 1 = one-step oracle; 95 %",
            *scoring.headings(rows, baselines),
        )
        for entries in scoring.entries(rows):
            shown.add_row(*map(escape, entries))
        print_whole(console, shown)
        console.print(f"written: {escape(str(directory / 'eval.md'))}")
        return 0
