"""The final table: anybody's coverage on layouts nobody has seen and on any scene, between random and the oracle.

Quick episodes, without the measuring of maps that `asg compare` does. Every policy plays the same episodes, so
intervals are over pairs.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.jobs import absolute_spec, scene_label, slug
from activestructure_gym.evaluation.statistics import Estimate, stratified_draws
from activestructure_gym.evaluation.statistics.resampling import REPEATS, interval
from activestructure_gym.evaluation.store import plain, read_json, write_json
from activestructure_gym.evaluation.training.config import WorldConfig
from activestructure_gym.evaluation.training.layouts import layout_specs
from activestructure_gym.evaluation.training.spreading import spread

if TYPE_CHECKING:
    from activestructure_gym.scenes import Scene

RANDOM, ORACLE_GREEDY = "random", "oracle-greedy"  # the references: 0 and 1 of the normalised area
LAYOUTS = "held-out layouts"
_EPISODES = "episodes"


@dataclass(frozen=True)
class Cell:
    """One episode that everybody plays."""

    scene: str
    seed: int
    group: str  # whose mean it belongs to

    @property
    def file(self) -> str:
        """Where its results are kept."""
        mark = hashlib.sha256(self.scene.encode()).hexdigest()[:6]  # two files may have one label
        return f"{slug(scene_label(self.scene))}-{mark}--seed{self.seed}.json"


@dataclass(frozen=True)
class Row:
    """A policy in a group of episodes."""

    policy: str
    group: str
    episodes: int
    auc: float  # mean coverage over the budget, %
    normalised: Estimate
    lead: Estimate | None  # normalised, minus the baseline's


def cells(layouts: int, rooms: Sequence[int], scenes: Sequence[str], seeds: Sequence[int]) -> list[Cell]:
    """One episode on each test layout, and one per seed in each of the scenes."""
    found = [Cell(spec, number, LAYOUTS) for number, spec in enumerate(layout_specs("test", layouts, rooms))]
    found += [Cell(absolute_spec(spec), seed, scene_label(spec)) for spec in scenes for seed in seeds]
    if not found:
        raise InputError("a score needs episodes: give --layouts, or --scenes with --seeds")
    return found


def play_cells(
    world: WorldConfig,
    policies: Sequence[str],  # as `canonical_policy` names them
    todo: Sequence[Cell],
    directory: Path,
    *,
    workers: int = 1,
    tell: Callable[[int, int], None] = lambda *_: None,
) -> None:
    """Play what is not in ``directory`` yet; each episode is kept as soon as all have played it."""
    conditions = {name: getattr(world, name) for name in ("preset", "frames", "max_planes")}
    conditions["overrides"] = dict(world.overrides)
    (directory / _EPISODES).mkdir(parents=True, exist_ok=True)
    record = directory / "score.json"
    if record.is_file() and read_json(record)["conditions"] != _json(conditions):
        raise InputError(f"'{directory}' was scored under other conditions: choose another --out")
    write_json(record, {"conditions": conditions})
    calls = [(world, tuple(policies), cell, directory) for cell in todo]
    for done in spread(play_cell, calls, workers):
        tell(done, len(todo))


def table(directory: Path, policies: Sequence[str], played: Sequence[Cell], baseline: str | None = None) -> list[Row]:
    """One row per policy and group, the references among them."""
    rows = []
    for group in dict.fromkeys(cell.group for cell in played):
        contents = [read_json(directory / _EPISODES / cell.file) for cell in played if cell.group == group]
        areas = {name: np.array([one[name]["auc"] for one in contents]) for name in (*policies, RANDOM, ORACLE_GREEDY)}
        draws = stratified_draws((len(contents),), REPEATS, 0)
        resampled = {name: _between(areas, name, draws) for name in areas}
        every = np.arange(len(contents))[None]
        for name in dict.fromkeys((RANDOM, *policies, ORACLE_GREEDY)):
            value = float(_between(areas, name, every)[0])
            lead = None
            if baseline is not None and name != baseline:
                other = float(_between(areas, baseline, every)[0])
                lead = _estimate(value - other, resampled[name] - resampled[baseline], len(contents))
            rows.append(
                Row(
                    name, group, len(contents), 100 * float(areas[name].mean()),
                    _estimate(value, resampled[name], len(contents)), lead,
                )
            )  # fmt: skip
    return rows


def markdown(rows: Sequence[Row], baseline: str | None = None) -> str:
    """The table for a page."""
    head = ["episodes on", "policy", "n", "AUC (%)", "normalised"] + ([f"minus {baseline}"] if baseline else [])
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    for row in rows:
        entries = [row.group, f"`{short_policy(row.policy)}`", str(row.episodes), f"{row.auc:.1f}"]
        entries += [words(row.normalised), *([words(row.lead)] if baseline else [])]
        lines.append("| " + " | ".join(entries) + " |")
    return "\n".join(lines) + "\n"


def words(estimate: Estimate | None) -> str:
    """A value with its interval."""
    if estimate is None:
        return ""
    if not estimate.has_interval:
        return f"{estimate.value:.3f}"
    return f"{estimate.value:.3f} [{estimate.low:.3f}, {estimate.high:.3f}]"


def short_policy(spec: str) -> str:
    """A checkpoint by the last two parts of its place; everything else as it is."""
    family, colon, place = spec.partition(":")
    if family != "learned" or not colon:
        return spec
    return f"learned:{'/'.join(Path(place.rpartition('@')[0] or place).with_suffix('').parts[-2:])}"


def _between(areas: Mapping[str, np.ndarray], name: str, draws: np.ndarray) -> np.ndarray:  # [R, N] -> [R]
    value, floor, ceiling = (areas[one][draws].mean(axis=1) for one in (name, RANDOM, ORACLE_GREEDY))
    span = ceiling - floor
    return np.where(span != 0, (value - floor) / np.where(span != 0, span, 1.0), np.nan)


def _estimate(value: float, resampled: np.ndarray, runs: int) -> Estimate:
    finite = resampled[np.isfinite(resampled)]
    if runs < 2 or not len(finite):
        return Estimate(value, None, None, runs)
    low, high = interval(finite)
    return Estimate(value, float(low), float(high), runs)


_loaded: dict[str, Scene] = {}  # the last scene of this process


def play_cell(world: WorldConfig, policies: Sequence[str], cell: Cell, directory: Path) -> None:
    """Let everybody play one episode who has not yet."""
    from activestructure_gym.evaluation.training.playing import play_oracle, play_policy
    from activestructure_gym.policies import make_policy
    from activestructure_gym.scenes import load_scene

    file = directory / _EPISODES / cell.file
    content: dict[str, Any] = read_json(file) if file.is_file() else {}
    missing = [name for name in dict.fromkeys((RANDOM, *policies, ORACLE_GREEDY)) if name not in content]
    if not missing:
        return
    if cell.scene not in _loaded:
        _loaded.clear()
        _loaded[cell.scene] = load_scene(cell.scene)
    scene = _loaded[cell.scene]
    for name in missing:
        if name == ORACLE_GREEDY:
            played = play_oracle(world, scene, cell.seed)
        else:
            played = play_policy(world, scene, make_policy(name), cell.seed)
        content[name] = {"auc": played.auc, "frames": played.frames, "coverage": played.coverage}
    write_json(file, content)


def _json(content: Any) -> Any:
    return json.loads(json.dumps(plain(content)))
