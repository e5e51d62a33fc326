"""Measure how good the choices of features and policies are, by ground truth: the command of `frozen_decisions`."""

from __future__ import annotations

import dataclasses
import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.archive.directory_lock import hold
from activestructure_gym.evaluation.cli.bench import print_rows
from activestructure_gym.evaluation.cli.options import parse_seeds, split_list, split_policies, split_scenes
from activestructure_gym.evaluation.cli.output import make_console, progress_bar, short_title
from activestructure_gym.evaluation.machine import hardware as machine
from activestructure_gym.files import replaced
from activestructure_gym.streams import escape
from benchmarks import frozen_decisions as benchmark
from benchmarks.command import run
from benchmarks.frozen_decisions import Settings

_RECORDS, _RESULT = "decisions.jsonl", "decisions.json"


@dataclass(frozen=True)
class Decisions:
    """Freeze decisions of episodes and compare choices by the true newly observed area of every candidate."""

    scenes: tuple[str, ...] = ()
    """Use these scenes, separated by commas or spaces; by default a room and an apartment."""
    seeds: tuple[str, ...] = ("0",)
    """Play one episode per seed; whole numbers from 0 on."""
    played: str = "hole_area"
    """Play the episodes with this policy."""
    features: tuple[str, ...] = ("hole_area", "pixel")
    """Score these features (columns, see `asg list features`), each times the shared travel term."""
    policies: tuple[str, ...] = ()
    """Score these policies too."""
    preset: str = "default"
    """Use this preset; `asg list config PRESET` prints it."""
    frames: int = 300
    """Play episodes of this many frames."""
    first: int = 1
    """Freeze decisions from this frame on."""
    every: int = 4
    """Freeze one of this many decisions."""
    pool: int | None = None
    """Draw this many views of the pool to find the best one; by default use all."""
    quality: int = 0
    """Map this many views of each frozen decision in a copy, for their effect on held-out views; 0 maps none."""
    out: str | None = None
    """Write decisions.json to this folder and resume with its finished episodes; by default print only."""
    quick: bool = False
    """Run a small version, which shows only that the benchmark works."""

    def run(self) -> int:
        """Measure, print a table, and return 0."""
        settings, seeds = self._settings(), parse_seeds(self.seeds)
        if self.out is None:
            return self._decide(settings, seeds, None)
        folder = Path(self.out)
        if folder.exists() and not folder.is_dir():
            raise InputError(f"--out is a directory for results, and '{folder}' is a file")
        with hold(folder):
            return self._decide(settings, seeds, folder)

    def _decide(self, settings: Settings, seeds: Sequence[int], folder: Path | None) -> int:
        console = make_console()
        scenes = split_scenes(self.scenes) or (("box",) if self.quick else benchmark.SCENES)
        records = [] if folder is None else _kept(folder, settings)
        asked = {(scene, seed) for scene in scenes for seed in seeds}
        with progress_bar(console, disable=not console.is_terminal) as bar:
            left = len(asked - {(record["scene"], record["seed"]) for record in records})
            task = bar.add_task("deciding", total=left * settings.frames)
            ended = 0

            def show(scene: str, seed: int, frames: int) -> None:
                title = short_title(console, f"{scene}, seed {seed}")
                bar.update(task, completed=ended * settings.frames + frames, description=title)

            for found in benchmark.run_decisions_benchmark(scenes, seeds, settings, done=records, notify=show):
                ended += 1
                records += found
                if folder is not None:
                    with replaced(folder / _RECORDS) as file:  # written atomically, so it always holds whole episodes
                        file.writelines(f"{json.dumps(record)}\n".encode() for record in records)
        records = [record for record in records if (record["scene"], record["seed"]) in asked]
        rows, quality = benchmark.decision_rows(records), benchmark.quality_rows(records)
        print_rows(console, rows, f"share of the best true rate, {len(records)} decisions of {escape(settings.played)}")
        if quality:
            print_rows(console, quality, "change by the picked view on held-out views, per 100 frames")
        if folder is not None:
            content: dict[str, Any] = {"settings": dataclasses.asdict(settings), "hardware": machine.hardware()}
            content |= {"rows": rows, "quality": quality, "decisions": records}
            _write(folder / _RESULT, content)
            console.print(f"written: {escape(str(folder / _RESULT))}")
        return 0

    def _settings(self) -> Settings:
        from activestructure_gym.config import known_preset
        from activestructure_gym.features import column_names
        from activestructure_gym.policies import make_policy

        played, policies = split_policies((self.played,)), split_policies(self.policies)
        if len(played) != 1:
            raise InputError(f"--played is one policy, got {len(played)}")
        for policy in (*played, *policies):
            make_policy(policy)
        column_names(split_list(self.features))  # raises InputError for unknown names before anything is written
        for name in ("frames", "first", "every"):
            if getattr(self, name) < 1:
                raise InputError(f"--{name} must be at least 1, got {getattr(self, name)}")
        if self.quality < 0 or (self.pool is not None and self.pool < 1):
            raise InputError("--quality must be at least 0 and --pool at least 1")
        return Settings(
            played=played[0],
            features=split_list(self.features),
            policies=policies,
            preset=known_preset("fast" if self.quick else self.preset),
            frames=40 if self.quick else self.frames,
            first=self.first,
            every=2 if self.quick else self.every,
            pool=200 if self.quick and self.pool is None else self.pool,
            quality=self.quality,
        )


def _kept(folder: Path, settings: Settings) -> list[dict[str, Any]]:
    """Return the records of the finished episodes in ``folder``.

    If the folder is new, write ``settings`` into it and return []. Raise `InputError` if it has other settings, or if a
    file is damaged.
    """
    written = json.loads(json.dumps(dataclasses.asdict(settings)))
    place, records = folder / "settings.json", folder / _RECORDS
    if not place.exists():
        if records.exists():
            raise InputError(f"'{folder}' holds decisions without their settings: choose another --out")
        _write(place, written)
        return []
    try:
        if json.loads(place.read_text(encoding="utf-8")) != written:
            raise InputError(f"'{folder}' was begun with other settings: give the same, or choose another --out")
        lines = records.read_text(encoding="utf-8").splitlines() if records.exists() else []
        return [json.loads(line) for line in lines]
    except ValueError as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"'{folder}' holds a damaged {place.name} or {records.name}: choose another --out") from error


def _write(place: Path, content: dict[str, Any]) -> None:
    with replaced(place) as file:
        file.write(f"{json.dumps(content, indent=1)}\n".encode())


if __name__ == "__main__":
    sys.exit(run(Decisions))
