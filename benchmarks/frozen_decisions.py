"""Compare the candidates that features and policies choose with the truly best candidate, by ground truth.

One policy plays an episode. Some of its decisions are frozen: the true rate of every candidate is computed from ground
truth. The true rate is the newly observed area along the path and at its end, in m^2 per frame. Each feature and each
policy then picks a row of the same candidate table; its pick is compared with the row that has the highest true rate.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.protocols import StandardProtocol
from activestructure_gym.evaluation.references.oracle_gains import QUALITY, TrueQuality, TrueSurface, whole_pool
from activestructure_gym.evaluation.statistics import estimate
from activestructure_gym.motion import PlannedPath

if TYPE_CHECKING:
    from activestructure_gym.config import Preset
    from activestructure_gym.envs import ReconstructionEnv
    from activestructure_gym.policies import Policy

SCENES = ("room?seed=22", "apartment?rooms=2&seed=21")
FEATURES = ("hole_area", "pixel")
_MIN_RATE = 1e-3  # m^2 per frame; decisions are left out if no candidate has a higher true rate
_SHORTLIST = 8  # number of rows with the highest feature; the best true rate among them is reported too


@dataclass(frozen=True)
class Settings:
    """Hold the settings of the benchmark, except scene and seed."""

    played: str = "hole_area"  # policy that plays the episodes
    features: tuple[str, ...] = FEATURES  # columns that are compared, each times the shared travel term
    policies: tuple[str, ...] = ()  # policies that are compared
    preset: Preset = "default"
    frames: int = 300  # frame budget of an episode
    first: int = 1  # frame from which on decisions are frozen
    every: int = 4  # freeze every n-th decision
    pool: int | None = None  # number of views drawn from the pool to find the best view; None: all
    quality: int = 0  # number of candidates per frozen decision that are mapped in a copy of the map; 0: none
    views: int = 8  # number of held-out views by which the copies of the map are measured


def frozen_decisions(
    scene: str, seed: int, settings: Settings, notify: Callable[[int], None] = lambda _: None
) -> list[dict[str, Any]]:
    """Play one episode, and return one record per frozen decision (see `_Judge.record`).

    ``notify`` is called with the number of frames so far.
    """
    from activestructure_gym.envs import ReconstructionEnv
    from activestructure_gym.ground_truth import ground_truth_of
    from activestructure_gym.policies import make_policy
    from activestructure_gym.scenes import load_scene

    truth = ground_truth_of(load_scene(scene))
    played, scored = make_policy(settings.played), {name: make_policy(name) for name in settings.policies}
    features = dict.fromkeys(n for policy in (played, *scored.values()) for n in policy.required_features)
    env = ReconstructionEnv(
        scene=truth,
        preset=settings.preset,
        frame_budget=settings.frames,
        features=tuple(features | dict.fromkeys(settings.features)),
        coverage_target=None,
    )
    judge = _Judge(truth, settings)
    records = []
    try:
        for policy in (played, *scored.values()):
            policy.bind(env)
            policy.reset(seed)
        observation, info = env.reset(seed=seed)
        ended = not observation["action_mask"].any()
        while not ended:
            row = int(played.act(observation))
            picks = _picks(env, observation, scored, settings.features)
            number, frames = env.reconstruction.decisions, env.reconstruction.frames
            if frames >= settings.first and number % settings.every == 0:
                record = judge.record(env, picks)
                records.append({"scene": scene, "seed": seed, "decision": number, "frames": frames} | record)
            observation, _, terminated, truncated, info = env.step(row)
            ended = terminated or truncated
            notify(int(info["frames"]))
    finally:
        env.close()
    return records


def _picks(
    env: ReconstructionEnv,
    observation: dict[str, np.ndarray],
    policies: Mapping[str, Policy],
    features: Sequence[str],
) -> dict[str, np.ndarray]:
    """Return the picks by name: for a feature all candidate rows by decreasing score, for a policy its chosen row."""
    from activestructure_gym.policies import Candidates, travel_discount

    candidates = Candidates(observation, env.config.features, "the benchmark of decisions")
    valid = np.flatnonzero(candidates.valid)
    found = {name: np.array([int(policy.act(observation))]) for name, policy in policies.items()}
    discount = travel_discount(observation)
    for name in features:
        try:
            score = candidates[name] * discount
        except InputError as error:
            raise InputError(f"only columns of a single number are scored: {error}") from error
        found[f"feature {name}"] = valid[np.argsort(-score[valid], kind="stable")]
    return found


class _Judge:
    """Measure the candidates of one episode by ground truth."""

    def __init__(self, truth: Any, settings: Settings) -> None:
        self._surface, self._settings = TrueSurface(truth), settings
        protocol = StandardProtocol(views=settings.views)
        self._quality = TrueQuality(truth, protocol) if settings.quality else None

    def record(self, env: ReconstructionEnv, picks: Mapping[str, np.ndarray]) -> dict[str, Any]:
        """Return the true rates at the current decision, in m^2 per frame.

        ``table`` has the best and the mean rate of the candidates, ``pool`` the best rate among the views of the pool,
        and ``picks`` the rates of the picked rows. With `Settings.quality`, ``quality`` has the change of image quality
        by each mapped candidate.
        """
        episode = env.reconstruction
        self._surface.follow(episode)
        taken = episode.agent.paths(episode.volume, episode.candidates.world_from_camera)
        rates = self._surface.rates(episode, taken)
        views = whole_pool(episode, self._settings.pool)
        pool = self._surface.rates(episode, episode.agent.paths(episode.volume, views))
        found: dict[str, Any] = {
            "observed": 100.0 * float(self._surface.seen.mean()),
            "table": {"views": len(rates), "best": float(rates.max()), "mean": float(rates.mean())},
            "pool": {"views": len(pool), "best": float(max(pool.max(initial=0.0), rates.max()))},
            "picks": {name: _scored(rates, rows) for name, rows in picks.items()},
        }
        if self._quality is not None:
            mapped = {row: path for row in self._mapped_rows(taken, picks) if (path := taken[row]) is not None}
            found["quality"] = {str(row): change for row, change in self._quality.changes(episode, mapped).items()}
        return found

    def _mapped_rows(self, taken: Sequence[PlannedPath | None], picks: Mapping[str, np.ndarray]) -> list[int]:
        """Return the candidate rows whose views are mapped in a copy of the map, usually `Settings.quality` of them.

        ``taken`` has the path to each candidate, and ``picks`` are as in `_picks`. The rows are the best row of every
        feature and the chosen row of every policy, all of them in any case, then rows spread evenly over the table.
        """
        firsts = [int(rows[0]) for rows in picks.values() if len(rows)]
        spread = np.linspace(0, len(taken) - 1, self._settings.quality).astype(int).tolist()
        rows = list(dict.fromkeys((*firsts, *spread)))[: max(self._settings.quality, len(set(firsts)))]
        return [row for row in rows if row < len(taken)]


def _scored(rates: np.ndarray, rows: np.ndarray) -> dict[str, Any]:
    """Return how good picked ``rows`` (best first) are by the true ``rates`` of all candidates.

    The result has the first row and its rate. For several rows it also has the best rate among the first `_SHORTLIST`
    rows, and the rank correlation between the order of the rows and their rates.
    """
    from scipy.stats import spearmanr

    known = rows[rows < len(rates)]
    if not len(known):
        return {"row": -1, "rate": 0.0}
    found: dict[str, Any] = {"row": int(known[0]), "rate": float(rates[known[0]])}
    if len(known) > 1:
        found["best_of_first"] = float(rates[known[:_SHORTLIST]].max())
        if np.ptp(rates[known]) > 0:
            found["rank_correlation"] = float(spearmanr(-np.arange(len(known)), rates[known]).statistic)
    return found


def decision_rows(records: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return a row per feature or policy: the true rate of its picks as a share of the best rate.

    ``records`` are those of `frozen_decisions`. Shares are means over scenes of means over decisions. Decisions without
    a candidate above `_MIN_RATE` are left out. Intervals are over the scenes; there are none for one
    scene. The first row is for a random candidate, the last one for the best candidate.
    """
    counted = [record for record in records if record["table"]["best"] > _MIN_RATE]
    names = list(dict.fromkeys(name for record in counted for name in record["picks"]))
    rows = [_row("any row, at random", counted, lambda r: r["table"]["mean"])]
    for name in names:
        own = [record for record in counted if name in record["picks"]]
        row = _row(name, own, _of_pick(name, "rate"))
        some = [r for r in own if "best_of_first" in r["picks"][name]]
        if some:
            reached = _of_pick(name, "best_of_first")
            best = _over_scenes(some, _share_of_table(reached))
            row[f"best_of_own_first_{_SHORTLIST}"] = best[0]
        ranked = [r for r in own if "rank_correlation" in r["picks"][name]]
        if ranked:
            row["rank_correlation"] = _over_scenes(ranked, _of_pick(name, "rank_correlation"))[0]
        rows.append(row)
    return rows + [_row("best of the table", counted, lambda r: r["table"]["best"])] if counted else []


def quality_rows(records: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return one row per feature or policy: the change of the held-out metrics when its picked view is mapped.

    ``records`` are those of `frozen_decisions`. The metrics are the keys of `QUALITY`. ``<metric>_per_100`` is the
    change per 100 frames of path, as the mean over scenes of means over decisions. ``<metric>_of_best`` is this change
    divided by the change of the best mapped view: 1 is as good as the best, and below 0 the view made the map worse.
    Both changes are summed over the decisions of a scene before the division, and the shares are averaged over scenes.
    Scenes in which even the best view improves nothing are left out of this average.

    Two more rows are for the mean and for the best of all mapped views.
    """
    counted = [record for record in records if record.get("quality")]
    names = list(dict.fromkeys(name for record in counted for name in record["picks"]))
    rows: list[dict[str, Any]] = []
    for pick in (*names, "mean of those mapped", "best of those mapped"):
        row: dict[str, Any] = {"pick": pick}
        for key, sign in QUALITY.items():
            values = [(r, v) for r in counted if (v := _changed(r, pick, key, sign)) is not None]
            by_scene: dict[str, list[float]] = {}
            for record, value in values:
                by_scene.setdefault(record["scene"], []).append(value)
            if by_scene:
                found = estimate([np.array([float(np.mean(own)) for own in by_scene.values()])])
                row[f"{key}_per_100"] = found.value
                row[f"{key}_interval"] = _interval(found.low, found.high)
                row[f"{key}_of_best"], row[f"{key}_of_best_interval"] = _of_best(values, key, sign)
        if len(row) > 1:
            rows.append(row)
    return rows


def _of_best(
    values: Sequence[tuple[Mapping[str, Any], float]], key: str, sign: float
) -> tuple[float | None, tuple[float, float] | None]:
    """Return the column ``<metric>_of_best`` of `quality_rows` with its interval, for one metric and one pick.

    ``values`` are (record, change) pairs, ``key`` is the metric, and ``sign`` is -1 if smaller values are better.
    """
    sums: dict[str, list[float]] = {}
    for record, value in values:
        best = _changed(record, "best of those mapped", key, sign)
        both = sums.setdefault(record["scene"], [0.0, 0.0])
        both[0] += sign * value
        both[1] += sign * (best or 0.0)
    shares = [own / best for own, best in sums.values() if best > 0.0]
    if not shares:
        return None, None
    found = estimate([np.array(shares)])
    return found.value, _interval(found.low, found.high)


def _changed(record: Mapping[str, Any], pick: str, key: str, sign: float) -> float | None:
    values = {row: found[key] for row, found in record["quality"].items() if key in found}
    if not values:
        return None
    if pick == "mean of those mapped":
        return float(np.mean(list(values.values())))
    if pick == "best of those mapped":
        return sign * max(sign * value for value in values.values())
    return values.get(str(record["picks"].get(pick, {}).get("row")))


def _of_pick(name: str, key: str) -> Callable[[Mapping[str, Any]], float]:
    return lambda record: float(record["picks"][name][key])


def _share_of_table(rate: Callable[[Mapping[str, Any]], float]) -> Callable[[Mapping[str, Any]], float]:
    return lambda record: rate(record) / record["table"]["best"]


def _row(name: str, records: Sequence[Mapping[str, Any]], rate: Callable[[Mapping[str, Any]], float]) -> dict[str, Any]:
    of_table, interval = _over_scenes(records, _share_of_table(rate))
    of_pool, interval_pool = _over_scenes(records, lambda r: rate(r) / r["pool"]["best"])
    return {
        "pick": name,
        "decisions": len(records),
        "of_the_table's_best": of_table,
        "interval": interval,
        "of_the_pool's_best": of_pool,
        "interval_pool": interval_pool,
    }


def _over_scenes(
    records: Sequence[Mapping[str, Any]], value: Callable[[Mapping[str, Any]], float]
) -> tuple[float | None, tuple[float, float] | None]:
    by_scene: dict[str, list[float]] = {}
    for record in records:
        by_scene.setdefault(record["scene"], []).append(value(record))
    if not by_scene:
        return None, None
    found = estimate([np.array([float(np.mean(own)) for own in by_scene.values()])])
    return found.value, _interval(found.low, found.high)


def _interval(low: float | None, high: float | None) -> tuple[float, float] | None:
    return None if low is None or high is None else (low, high)


def run_decisions_benchmark(
    scenes: Sequence[str],
    seeds: Sequence[int],
    settings: Settings,
    *,
    done: Sequence[Mapping[str, Any]] = (),  # existing records; their episodes are not played again
    notify: Callable[[str, int, int], None] = lambda scene, seed, frames: None,
) -> Iterator[list[dict[str, Any]]]:
    """Play one episode per scene and seed, except those in ``done``; yield the records of each episode.

    ``notify`` is called with the scene, the seed and the number of frames so far.
    """
    have = {(record["scene"], record["seed"]) for record in done}
    for scene in scenes:
        for seed in seeds:
            if (scene, seed) not in have:
                yield frozen_decisions(scene, seed, settings, partial(notify, scene, seed))
