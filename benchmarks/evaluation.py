"""Measure the time of each stage of evaluating one episode, when the ground truth is in the cache already."""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from rich.console import Console

from activestructure_gym.evaluation.archive.conditions import Conditions
from activestructure_gym.evaluation.cli.bench import print_rows
from activestructure_gym.evaluation.cli.options import split_scenes
from activestructure_gym.evaluation.cli.output import make_console
from activestructure_gym.evaluation.machine.threads import thread_cap
from activestructure_gym.ground_truth import ground_truth_of
from activestructure_gym.specs import Spec
from activestructure_gym.streams import escape
from benchmarks.command import run

if TYPE_CHECKING:
    from activestructure_gym.config import Preset

T = TypeVar("T")
SCENES = ("room", "apartment?rooms=3&seed=5")


def measure_evaluation(console: Console, scenes: Sequence[str], *, quick: bool) -> list[dict[str, Any]]:
    """Explore every scene once with the policy random, then time each stage of its evaluation.

    The protocol is ``standard``; ``quick`` has fewer frames, views and points. Return one row per scene and stage, with
    wall and processor time in seconds.
    """
    from activestructure_gym.evaluation.protocols import StandardProtocol

    protocol = StandardProtocol(views=4, surface_samples=20_000) if quick else StandardProtocol()
    rows = []
    for scene in scenes or (("box",) if quick else SCENES):
        with console.status(f"measuring the evaluation of {escape(scene)}"):
            rows += list(_rows(scene, protocol, frames=25 if quick else 200, preset="fast" if quick else "default"))
    return rows


def _rows(spec: str, protocol: Any, *, frames: int, preset: Preset) -> Iterator[dict[str, Any]]:
    from activestructure_gym.evaluation.archive.jobs import Job
    from activestructure_gym.evaluation.metrics import geometry_scores
    from activestructure_gym.evaluation.metrics.geometry import streamed_scores
    from activestructure_gym.evaluation.reproduction.remeasure import read_path
    from activestructure_gym.evaluation.running.episode import (
        CHECKPOINT_SAMPLES,
        CHECKPOINTS,
        IMAGE_CHECKPOINTS,
        run_job,
    )
    from activestructure_gym.mapping import GaussianMap
    from activestructure_gym.scenes import load_scene

    with tempfile.TemporaryDirectory(prefix="asg-bench-") as directory:
        run = run_job(
            Job(Spec(spec), Spec("random"), 0, conditions=Conditions(preset, frames, protocol=protocol)),
            Path(directory) / "r",
        )
        gaussians = GaussianMap.load_npz(run.directory / "map.npz")
        path = read_path(run.directory / "trajectory.npz")
    scene = load_scene(spec)
    name = {"scene": spec, "gaussians": gaussians.count, "keyframes": len(path.keyframes), "threads": thread_cap()}
    truth, cost = _timed(lambda: protocol.truth(ground_truth_of(scene)))
    yield {**name, "stage": "truth from the cache", **cost}
    threshold = protocol.threshold_m
    truth.surface.discs, truth.surface.samples  # noqa: B018 - builds the search trees, once per scene
    _, cost = _timed(lambda: geometry_scores(protocol.points(gaussians), truth.surface, threshold_m=threshold))
    yield {**name, "stage": "distances of the means", **cost}
    points, cost = _timed(lambda: protocol.on_surface(protocol.surface(gaussians, path).pieces))
    yield {**name, "stage": "TSDF surface", **cost}
    _, cost = _timed(
        lambda: streamed_scores(points.pieces(), points.count, truth.surface, threshold_m=threshold, to_samples=False)
    )
    yield {**name, "stage": "distances of the surface", **cost}
    _, cost = _timed(lambda: protocol.observed(truth, path))
    yield {**name, "stage": "observed", **cost}
    _, cost = _timed(lambda: protocol.view_scores(gaussians, truth, {}))
    yield {**name, "stage": f"{len(truth.views)} views", **cost}
    fresh = protocol.truth(ground_truth_of(scene))
    _, whole = _timed(lambda: protocol.evaluate(gaussians, fresh, path))
    yield {**name, "stage": "finished map, all of it", **whole}

    def checkpoint(*, images: bool) -> dict[str, float]:
        return _timed(lambda: protocol.checkpoint(gaussians, truth, path, images=images, samples=CHECKPOINT_SAMPLES))[1]

    point, looks = checkpoint(images=False), checkpoint(images=True)
    curve = {key: (CHECKPOINTS + 1) * value + IMAGE_CHECKPOINTS * (looks[key] - value) for key, value in point.items()}
    yield {**name, "stage": f"curve of {CHECKPOINTS + 1} points (at most)", **curve}
    yield {**name, "stage": "episode", **{key: whole[key] + curve[key] for key in whole}}


def _timed(work: Callable[[], T]) -> tuple[T, dict[str, float]]:
    wall, processor = time.perf_counter(), time.process_time()
    result = work()
    return result, {"wall_s": time.perf_counter() - wall, "processor_s": time.process_time() - processor}


@dataclass(frozen=True)
class Evaluation:
    """Measure the cost of evaluating an episode, by stages."""

    scenes: tuple[str, ...] = ()
    """Use these scenes, separated by commas or spaces; by default a room and an apartment."""
    quick: bool = False
    """Run a small version, which shows only that the benchmark works."""

    def run(self) -> int:
        """Measure, print a table, and return 0."""
        console = make_console()
        rows = measure_evaluation(console, split_scenes(self.scenes), quick=self.quick)
        print_rows(console, rows, "cost of an episode's evaluation, with cached ground truth")
        return 0


if __name__ == "__main__":
    sys.exit(run(Evaluation))
