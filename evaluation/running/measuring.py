"""Turn a played episode into a finished run using only its files: measure its map, then draw its pictures.

The episode's directory is replaced only by the complete run. So an interrupted measurement can be repeated.
"""

from __future__ import annotations

import json
import time
import warnings
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from activestructure_gym.errors import InputWarning
from activestructure_gym.evaluation.archive import completion, json_files, played, store
from activestructure_gym.evaluation.archive.conditions import Conditions
from activestructure_gym.evaluation.archive.jobs import Job, refuse_code
from activestructure_gym.evaluation.archive.picture_record import captured_pictures, held_out_pictures
from activestructure_gym.evaluation.archive.temporary import atomic_files
from activestructure_gym.evaluation.metrics.planning import CURVE_MEASURES, planning_scores
from activestructure_gym.evaluation.protocols import CameraPath, get_protocol
from activestructure_gym.evaluation.protocols.base import measure_by
from activestructure_gym.evaluation.protocols.metrics import MetricContext, added_metrics, measure_metrics
from activestructure_gym.evaluation.protocols.metrics.without_truth import NO_TRUTH, WITHOUT_TRUTH, unmeasured
from activestructure_gym.evaluation.running.surroundings import Surroundings, stored_surroundings
from activestructure_gym.npz import write_npz
from activestructure_gym.specs import Spec
from activestructure_gym.worlds import StoredCaptures

if TYPE_CHECKING:
    from activestructure_gym.evaluation.protocols import Truth


def measure(job: Job, place: Path, directory: Path, where: Surroundings, truth: Truth | None) -> store.Run:
    """Measure the episode in ``place`` and write the run into ``directory``, completely or not at all.

    Without ``truth``, the metrics that need it are None.
    """
    from activestructure_gym.mapping import GaussianMap

    began = time.perf_counter()
    episode = played.read_episode(place)
    arrays, gaussians = played.read_path(place), GaussianMap.load_npz(place / store.MAP)
    path, poses = CameraPath.from_arrays(arrays), arrays["world_from_camera"]
    metrics = unmeasured() if truth is None else job.conditions.protocol.evaluate(gaussians, truth, path)
    # The last point of the curve holds the metrics of the finished map.
    last = {name: metrics[name] for name in CURVE_MEASURES if metrics.get(name) is not None}
    episode["curve"][-1] |= last
    planned, reasons = planning_scores(episode["curve"], episode["frame_budget"])
    metrics |= planned | {"planning_notes": reasons} | episode["metrics"]
    described: list[dict[str, Any]]
    if truth is None or where.known is None:
        unknown = added_metrics(job.conditions.metrics, metrics)
        described = [metric.as_dict() for metric in WITHOUT_TRUTH]
        described += [metric.as_dict() | {"reason": NO_TRUTH} for metric in unknown]
        metrics |= dict.fromkeys(metric.name for metric in unknown)
        pictures = captured_pictures(gaussians, StoredCaptures(place / store.CAPTURES), path)
    else:
        context = MetricContext(gaussians, truth, where.known, job.conditions.protocol, path, poses, dict(metrics))
        values, described = measure_metrics(job.conditions.metrics, context)
        metrics |= values
        views = [view["psnr"] for view in metrics["views"]]
        pictures = held_out_pictures(job.conditions.protocol, truth, gaussians, views)
    with completion.atomic_directory(directory) as part:
        played.link_files(place, part)
        _write_numbers(part, job, where, metrics, episode["curve"], described)
        _write_steps(place / store.STEPS, part / store.STEPS, last)
        for other in map(get_protocol, job.conditions.also):
            numbers = measure_by(other, gaussians, where.truth(other), path)
            store.write_evaluation(part, other.parameters(), where.facts["content_hash"], numbers)
        write_npz(part / store.PICTURES, pictures | played.read_plan(place))
        _write_clocks(part, episode["clock"], time.perf_counter() - began)
        # The completion marker is written last: a directory without it is not a result.
        store.finish(part, job)
    run = store.read_run(directory)
    draw_missing_pictures(run)
    return run


def measure_played(directory: Path) -> store.Run | None:
    """Measure the played episode in a run's directory and return the run; None if there is no played episode.

    Raise `InputError` if the scene is missing or has changed, or if the job names code that is not trusted.
    """
    place = played.played_episode(directory)
    if place is None:
        return None
    job = played.job_of(place)
    # No policy acts here: only the scene, the protocols and the metrics of the job are loaded.
    measured = Conditions(also=job.conditions.also, metrics=job.conditions.metrics)
    refuse_code([replace(job, policy=Spec("random"), conditions=measured)], place / store.CONFIG)
    where = stored_surroundings(job, place)
    return measure(job, place, directory, where, where.truth(job.conditions.protocol))


def _write_numbers(
    part: Path,
    job: Job,
    where: Surroundings,
    metrics: Mapping[str, Any],
    curve: list[dict[str, Any]],
    described: list[dict[str, Any]],  # of the metrics in ``metrics`` that no protocol measures
) -> None:
    results = {
        "format": store.FORMAT_VERSION,
        "protocol": job.conditions.protocol.parameters(),
        "scene": where.facts["content_hash"],
        "metrics": metrics,
        "curve": curve,
        **({"own_metrics": described} if described else {}),
    }
    json_files.write_json(part / store.METRICS, results)


def _write_steps(source: Path, target: Path, last: Mapping[str, Any]) -> None:
    """Copy the log of decisions, and add the numbers of the finished map to the last checkpoint."""
    with open(source, encoding="utf-8") as lines, open(target, "w", encoding="utf-8") as file:
        before = ""
        for line in lines:
            file.write(before)
            before = line
        if before:
            try:
                step = json.loads(before)
                step["checkpoint"] |= last
            except (ValueError, TypeError, KeyError) as error:
                raise played.damaged(source, error) from error
            file.write(json_files.json_line(step))


def _write_clocks(part: Path, clock: Mapping[str, Any], seconds: float) -> None:
    timing = {
        "seconds": clock["seconds"] | {"evaluation": clock["evaluation"] + seconds},
        "total": clock["total"],
        "decisions": clock["decisions"],
        "hardware": clock["hardware"],
    }
    json_files.write_json(part / "timing.json", timing)


def draw_missing_pictures(run: store.Run) -> None:
    """Draw the pictures of a finished run that has none. A failure is a warning: the run is complete without them."""
    from activestructure_gym.evaluation.report.pictures.run_figures import VIEWS, draw_run

    if (run.directory / VIEWS).exists():
        return
    try:
        with atomic_files(run.directory) as part:
            draw_run(run, part)
    except Exception as error:
        text = f"no pictures of {run.job.title}: {error}; its numbers and files are complete"
        warnings.warn(text, InputWarning, stacklevel=2)
