"""Score policies by the area under the coverage curve, on test layouts and on any scenes.

The area is normalised: 0 is the mean of random choice, 1 that of the one-step oracle. Maps are not measured, in
contrast to `asg compare`. All policies play the same episodes, so their differences are paired.
"""

from __future__ import annotations

import hashlib
import json
import math
import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from activestructure_gym._version import __version__
from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.archive import schema
from activestructure_gym.evaluation.archive.conditions import Conditions
from activestructure_gym.evaluation.archive.jobs import Job, absolute_spec, scene_label, scene_labels, slug
from activestructure_gym.evaluation.archive.json_files import as_read, read_json, write_json
from activestructure_gym.evaluation.archive.plugin_code import first_checksum_of, plugin_code_of
from activestructure_gym.evaluation.archive.temporary import refuse_links, unlinked
from activestructure_gym.evaluation.report.tables.formats import code, escaped
from activestructure_gym.evaluation.statistics import Estimate, stratified_draws, t_quantile
from activestructure_gym.evaluation.training.config import WorldConfig
from activestructure_gym.evaluation.training.process_pool import spread
from activestructure_gym.ground_truth.layouts import layout_specs
from activestructure_gym.specs import Spec

if TYPE_CHECKING:
    from activestructure_gym.ground_truth import FreeSpace, GroundTruth

RANDOM, ORACLE_GREEDY = "random", "oracle-greedy"  # the references, with the normalised area 0 and 1
LAYOUTS = "held-out layouts"
_EPISODES = "episodes"
RECORD = "score.json"
_EPISODE = schema.table(
    {}, {"scene_hash": schema.text, "start": schema.anything}, others=schema.table({"auc": schema.number()})
)
_AGAIN, _ELSEWHERE = "delete it, and the episode is played again", "choose another --out"


@dataclass(frozen=True)
class Cell:
    """Define one episode, which every policy plays."""

    scene: str  # name for `load_scene`
    seed: int
    group: str  # the test layouts, or a scene; scores are averaged over a group
    start: int | None = None  # number of the start pose, see `start_pose`; None: drawn by the seed

    @property
    def file(self) -> str:
        """Return the name of the file that holds all policies' results of the episode."""
        mark = hashlib.sha256(self.scene.encode()).hexdigest()[:6]  # since different scenes may have the same label
        start = "" if self.start is None else f"--start{self.start}"
        return f"{slug(scene_label(self.scene))}-{mark}--seed{self.seed}{start}.json"


@dataclass(frozen=True)
class Row:
    """Hold the scores of a policy over a group of episodes."""

    policy: str
    group: str
    episodes: int  # number of episodes
    auc: float  # area under the coverage curve, as the mean coverage over the frame budget, in %
    normalised: Estimate  # the area, where random choice is 0 and the oracle is 1
    leads: tuple[Estimate | None, ...] = ()  # normalised area minus each baseline's; None for the baseline itself
    starts: int = 0  # number of different pairs of scene and start pose


def cells(layouts: int, rooms: Sequence[int], scenes: Sequence[str], seeds: Sequence[int]) -> list[Cell]:
    """Define the episodes: one per test layout, and one per scene and seed.

    ``layouts`` is the number of test layouts, and ``rooms`` the numbers of rooms that they take in turn. The n-th seed
    begins at the n-th start pose of a scene. Raise `InputError` if there is no episode.
    """
    found = [Cell(spec, number, LAYOUTS) for number, spec in enumerate(layout_specs("test", layouts, rooms))]
    for spec, label in scene_labels(dict.fromkeys(map(absolute_spec, scenes), "")).items():  # each scene once
        found += [Cell(spec, seed, label, start) for start, seed in enumerate(seeds)]
    if not found:
        raise InputError("an evaluation needs episodes: give --layouts, or --scenes with --seeds")
    return found


def play_cells(
    world: WorldConfig,
    policies: Sequence[str],  # names in the form that `canonical_policy` returns
    todo: Sequence[Cell],
    directory: Path,
    *,
    workers: int = 1,
    notify: Callable[[int, int], None] = lambda *_: None,
) -> None:
    """Play the episodes ``todo`` whose results ``directory`` lacks, in ``workers`` processes.

    A result is written as soon as a policy has played an episode. ``notify`` is called with the number of finished
    episodes and the number of all. Raise `InputError` if the directory holds results of other conditions, or if a
    policy fails; its traceback is in ``logs/``.
    """
    conditions = {name: getattr(world, name) for name in ("preset", "frames", "max_planes")}
    conditions["overrides"] = dict(world.overrides)
    conditions |= {"starts": "in turn", "version": __version__}
    refuse_links(directory, _EPISODES)
    (directory / _EPISODES).mkdir(parents=True, exist_ok=True)
    record = directory / RECORD
    known = (
        read_json(record, schema.table({"conditions": schema.table()}), remedy=_ELSEWHERE) if record.is_file() else {}
    )
    if known and known["conditions"] != as_read(conditions):
        raise InputError(f"'{directory}' was scored under other conditions: choose another --out")
    write_json(record, {"conditions": conditions})
    calls = [(world, tuple(policies), cell, directory) for cell in todo]
    for done in spread(play_cell, calls, workers):
        notify(done, len(todo))


def start_pose(space: FreeSpace, number: int) -> np.ndarray:  # [4, 4] world_from_camera
    """Return start pose ``number`` of a scene; numbers beyond its start poses repeat them, turned left by 90 degrees.

    Poses drawn by seed would repeat: 20 episodes would begin at about 12 of a scene's 16 start poses.
    """
    poses = space.start_poses
    turns, index = divmod(number, len(poses))
    cosine, sine = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[turns % 4]
    pose = np.array(poses[index], np.float64)
    pose[:3, :3] = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]]) @ pose[:3, :3]
    return pose


def table(directory: Path, policies: Sequence[str], played: Sequence[Cell], baselines: Sequence[str] = ()) -> list[Row]:
    """Return one row per group of episodes and policy, including random choice and the oracle.

    ``played`` are episodes whose results are in ``directory``. ``baselines`` are the policies that `Row.leads` compares
    with.
    """
    rows = []
    for group in dict.fromkeys(cell.group for cell in played):
        own = [cell for cell in played if cell.group == group]
        contents = [read_json(directory / _EPISODES / cell.file, _EPISODE, remedy=_AGAIN) for cell in own]
        starts = len({(cell.scene, json.dumps(one["start"])) for cell, one in zip(own, contents)})
        areas = {name: np.array([one[name]["auc"] for one in contents]) for name in (*policies, RANDOM, ORACLE_GREEDY)}
        every = np.arange(len(contents))[None]
        draws = stratified_draws((len(contents),)) if len(contents) > 1 else every
        resampled = {name: _between(areas, name, draws) for name in areas}
        for name in dict.fromkeys((RANDOM, *policies, ORACLE_GREEDY)):
            value = float(_between(areas, name, every)[0])
            leads: list[Estimate | None] = []
            for baseline in baselines:
                other = float(_between(areas, baseline, every)[0])
                lead = _estimate(value - other, resampled[name] - resampled[baseline], len(contents))
                leads.append(None if name == baseline else lead)
            rows.append(
                Row(
                    name, group, len(contents), 100 * float(areas[name].mean()),
                    _estimate(value, resampled[name], len(contents)), tuple(leads), starts,
                )
            )  # fmt: skip
    return rows


def headings(rows: Sequence[Row], baselines: Sequence[str] = ()) -> list[str]:
    """Return the column headings of the table of ``rows``; each baseline has a column of differences."""
    short = short_policies([row.policy for row in rows])
    names = [short.get(baseline, baseline) for baseline in baselines]
    return ["episodes on", "policy", "n", "starts", "AUC (%)", "normalised", *(f"minus {name}" for name in names)]


def entries(rows: Sequence[Row]) -> list[list[str]]:
    """Return the cells of the table as texts, row by row."""
    short = short_policies([row.policy for row in rows])
    lines = []
    for row in rows:
        numbers = [str(row.episodes), str(row.starts), f"{row.auc:.1f}", words(row.normalised)]
        lines.append([row.group, short[row.policy], *numbers, *map(words, row.leads)])
    return lines


def markdown(rows: Sequence[Row], baselines: Sequence[str] = ()) -> str:
    """Return the table of ``rows`` as Markdown."""
    head = [escaped(heading) for heading in headings(rows, baselines)]
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    for group, policy, *others in entries(rows):
        name = code(policy).replace("|", "\\|")
        lines.append("| " + " | ".join([escaped(group), name, *others]) + " |")
    return "\n".join(lines) + "\n"


def words(estimate: Estimate | None) -> str:
    """Format an estimate with three decimals and its interval: "0.512 [0.480, 0.544]"; None gives an empty text.

    An area is not normalised ("n/a") if random choice and the oracle have equal areas.
    """
    if estimate is None:
        return ""
    if not math.isfinite(estimate.value):
        return "n/a"
    ends = (estimate.low, estimate.high)
    value, *interval_ = (f"{round(number, 3) + 0.0:.3f}" for number in (estimate.value, *ends) if number is not None)
    return f"{value} [{', '.join(interval_)}]" if interval_ else value


def short_policy(spec: str) -> str:
    """Shorten the path in ``learned:PATH@CHECKSUM`` to its last two parts; return other names of policies unchanged."""
    family, colon, place = spec.partition(":")
    if family != "learned" or not colon:
        return spec
    return f"learned:{'/'.join(Path(place.rpartition('@')[0] or place).with_suffix('').parts[-2:])}"


def short_policies(specs: Sequence[str]) -> dict[str, str]:
    """Return a short name for each policy; the checksum of a checkpoint is appended if two short names are equal."""
    short = {spec: short_policy(spec) for spec in specs}
    names = list(short.values())
    return {
        spec: f"{name}@{spec.rpartition('@')[2]}" if names.count(name) > 1 and "@" in spec else name
        for spec, name in short.items()
    }


def _between(areas: Mapping[str, np.ndarray], name: str, draws: np.ndarray) -> np.ndarray:  # [R, N] -> [R]
    value, floor, ceiling = (areas[one][draws].mean(axis=1) for one in (name, RANDOM, ORACLE_GREEDY))
    span = ceiling - floor
    return np.where(span != 0, (value - floor) / np.where(span != 0, span, 1.0), np.nan)


def _estimate(value: float, resampled: np.ndarray, runs: int) -> Estimate:
    finite = resampled[np.isfinite(resampled)]
    if runs < 2 or not len(finite):
        return Estimate(value, None, None, runs)
    half = t_quantile(runs - 1) * float(finite.std(ddof=1))
    return Estimate(value, value - half, value + half, runs)


_loaded: dict[str, GroundTruth] = {}  # the scene that this process loaded last, by name


def play_cell(world: WorldConfig, policies: Sequence[str], cell: Cell, directory: Path) -> None:
    """Play one episode with every policy whose result is missing, and write each result to ``directory``.

    The result of a policy whose plug-in code has changed counts as missing. Raise `InputError` if a policy fails.
    """
    from activestructure_gym.evaluation.running.engines.failure_text import error_text
    from activestructure_gym.evaluation.training.rollout import play_oracle, play_policy
    from activestructure_gym.ground_truth import ground_truth_of
    from activestructure_gym.policies import make_policy
    from activestructure_gym.scenes import load_scene

    file = directory / _EPISODES / cell.file
    content: dict[str, Any] = read_json(file, _EPISODE, remedy=_AGAIN) if file.is_file() else {}
    codes = {name: _code_of(world, name) for name in (RANDOM, *policies, ORACLE_GREEDY)}  # before they are imported
    missing = [name for name, code in codes.items() if content.get(name, {"code": None}).get("code", {}) != code]
    if not missing:
        return
    if cell.scene not in _loaded:
        _loaded.clear()
        _loaded[cell.scene] = ground_truth_of(load_scene(cell.scene))
    truth = _loaded[cell.scene]
    scene = truth.scene
    if content.setdefault("scene_hash", scene.content_hash) != scene.content_hash:
        raise InputError(f"'{file}' was played in another scene than the current '{cell.scene}': choose another --out")
    start = None if cell.start is None else start_pose(truth.free_space, cell.start)
    content["start"] = "drawn" if start is None else start
    for name in missing:
        try:
            if name == ORACLE_GREEDY:
                played = play_oracle(world, truth, cell.seed, start)
            else:
                played = play_policy(world, truth, make_policy(name), cell.seed, start)
        except Exception as error:  # a plug-in policy may raise any exception
            log = directory / "logs" / f"{file.stem}.log"
            log.parent.mkdir(exist_ok=True)
            unlinked(log).write_text(traceback.format_exc(), encoding="utf-8")
            said = str(error) if isinstance(error, InputError) else error_text(error)
            raise InputError(
                f"{name} on {scene_label(cell.scene)}, seed {cell.seed}: {said}; the traceback is in "
                f"'{log}', and finished results are kept"
            ) from error
        content[name] = {"auc": played.auc, "frames": played.frames, "coverage": played.coverage}
        content[name] |= {"code": codes[name]} if codes[name] else {}
        write_json(file, content)


def _code_of(world: WorldConfig, policy: str) -> dict[str, str]:
    """Return the checksums of the plug-in code that an episode of ``policy`` runs, by kind and name."""
    job = Job(Spec(""), Spec(policy), 0, conditions=Conditions(overrides=dict(world.overrides)))
    return plugin_code_of(job, first_checksum_of)
