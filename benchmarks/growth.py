"""Measure the times of a mapping event and of a decision in one place while the map grows elsewhere.

A mapping event is `Mapper.observe` of one frame. 20 keyframes are taken around one start pose of an apartment (a
place), 20 around the next, and so on. Each place is shifted up by 30 m relative to the last one, so no view of a place
shows another place. At certain numbers of keyframes, copies of the map observe the same frames of the first place and
score the same 256 views of it. The Gaussians in view are the same at every size, so additional time comes from the size
of the map.

Clock rates change within minutes, so the ratio between two sizes is not computed from the rows. Instead, copies of both
maps are kept, and both observe each frame in direct succession.
"""

from __future__ import annotations

import copy
import os
import statistics
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from activestructure_gym.evaluation.cli.bench import print_rows
from activestructure_gym.evaluation.cli.output import make_console
from activestructure_gym.geometry import PinholeCamera, invert_rigid
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.ground_truth import ground_truth_of
from activestructure_gym.mapping.gaussian_map import MEAN
from activestructure_gym.mapping.mapper import Mapper
from activestructure_gym.motion import DistanceMap, path_lengths
from activestructure_gym.planes import PlaneSceneGraph
from activestructure_gym.scenes.scene import Scene
from activestructure_gym.streams import escape
from activestructure_gym.volume import VoxelVolume
from benchmarks.command import measuring, run, write_rows
from benchmarks.mapping_views import KEYFRAME_EVERY, capture, random_walk, true_volume

SCENE = "apartment?seed=1&rooms=4"
SIZE = (160, 90)  # width and height of frames in pixels
SCORED = 256  # number of scored candidate views, which have half the size, as in the default preset
CHECKPOINTS = (4, 10, 20, 50, 100, 200, 300, 400)  # numbers of keyframes; 4 keyframes give about 9,000 Gaussians
PAIR = (20, 400)  # numbers of keyframes of the two maps that are compared frame by frame
PLACE_KEYFRAMES = 20  # keyframes per place; after all 16 start poses, the first one is used again
_RADIUS = 1.8  # radius of a place as a path length in metres
STOREY = 30.0  # metres; view rays rise by at most 44 degrees, so points 30 m above and 10 m away are never in view


@dataclass(frozen=True)
class GrowthRow:
    """Hold the times at one size of the map: processor milliseconds, as medians over the timed frames."""

    keyframes: int
    gaussians: int
    in_view: int  # number of Gaussians whose centre projects into a timed frame, median
    event_ms: float  # `Mapper.observe` of a new frame of the first place
    decision_ms: float  # `Mapper.keyframe_psnr`, called once per decision
    scoring_ms: float  # `render_depth_alpha` of 256 views of the first place
    memory_mb: float  # resident memory of the whole process


@dataclass(frozen=True)
class GrowthPair:
    """Hold the ratios between the times of the same frame in a large and in a small map."""

    keyframes: tuple[int, int]  # of the small and of the large map
    gaussians: tuple[int, int]  # of the small and of the large map
    in_view: tuple[int, int]  # as in `GrowthRow`, of the small and of the large map
    pairs: int  # number of pairs of events
    event_ratio: tuple[float, float, float]  # large / small: lower quartile, median, upper quartile over the pairs
    decision_ratio: tuple[float, float, float]  # as ``event_ratio``, for `Mapper.keyframe_psnr`


def run_growth_benchmark(
    scene: Scene,
    mapper: Mapper,
    *,
    checkpoints: Sequence[int] = CHECKPOINTS,
    size: tuple[int, int] = SIZE,
    scored: int = SCORED,
    probes: int = 9,
    pair: tuple[int, int] = PAIR,  # two of the checkpoints
    seed: int = 0,
    advance: Callable[[], None] = lambda: None,  # called `growth_steps` times
) -> tuple[list[GrowthRow], GrowthPair]:
    """Grow the empty ``mapper`` along a seeded walk, measure it at every checkpoint, and compare two checkpoints.

    ``checkpoints`` are numbers of keyframes, ``size`` is (width, height) in pixels, ``scored`` the number of scored
    views, and ``probes`` the number of timed frames. A voxel volume and a plane graph are updated too, so the memory is
    as in an episode.
    """
    frames, probe_frames, candidates = places(scene, max(checkpoints), size, scored, probes, seed, advance)
    volume, planes = VoxelVolume(scene.bounds), PlaneSceneGraph()
    scoring = PinholeCamera.from_size(max(1, size[0] // 2), max(1, size[1] // 2))
    rows, kept = [], {}
    for index, frame in enumerate(frames):
        mapper.observe(_raised(frame, index // PLACE_KEYFRAMES))
        volume.integrate(frame, sensor_range=10.0)
        planes.update(frame, space_state=volume.state_at)
        advance()
        if index + 1 in checkpoints:
            rows.append(_measure(mapper, probe_frames, scoring, candidates))
        if index + 1 in pair:
            kept[index + 1] = copy.deepcopy(mapper)
    return rows, _compare(kept[pair[0]], kept[pair[1]], probe_frames)


def growth_steps(checkpoints: Sequence[int]) -> int:
    """Return how often `run_growth_benchmark` calls ``advance`` for these numbers of keyframes."""
    return 2 * max(checkpoints)


def places(
    scene: Scene,
    keyframes: int,
    size: tuple[int, int],
    scored: int,
    probes: int,
    seed: int,
    advance: Callable[[], None] = lambda: None,
) -> tuple[list[Frame], list[Frame], np.ndarray]:  # keyframes, probes, candidates [C, 4, 4]
    """Walk through a scene place by place, and return the keyframes, the timed frames, and the scored views.

    Places are not shifted up yet. The timed frames and the scored views are of the first place. ``keyframes``,
    ``scored`` and ``probes`` are the numbers of keyframes, scored views and timed frames, and ``size`` is (width,
    height) of a frame in pixels.
    """
    starts = ground_truth_of(scene).free_space.start_poses
    volume = true_volume(scene)
    places = -(-keyframes // PLACE_KEYFRAMES)
    picks, *walks = (np.random.default_rng(child) for child in np.random.SeedSequence(seed).spawn(places + 1))
    poses = []
    for place, rng in enumerate(walks):
        start = starts[place % len(starts)]
        near = partial(_within_radius, path_lengths(volume, start[:3, 3], min_clearance=0.2))
        poses.append(
            random_walk(
                volume,
                start,
                PLACE_KEYFRAMES * KEYFRAME_EVERY,
                rng,
                goal_allowed=near,
            )
        )
    keyframe_poses = np.concatenate([walk[::KEYFRAME_EVERY] for walk in poses])[:keyframes]
    # Timed frames are between keyframes of the first place: they are new to the map, but show no new surface.
    between = np.delete(poses[0], np.arange(0, len(poses[0]), KEYFRAME_EVERY), axis=0)
    camera = PinholeCamera.from_size(*size)
    frames = capture(scene, camera, keyframe_poses, supersample=2, advance=advance)
    timed = between[np.sort(picks.choice(len(between), probes, replace=False))]
    candidates = poses[0][picks.integers(len(poses[0]), size=scored)]
    return frames, capture(scene, camera, timed, supersample=2), candidates


def _within_radius(distances: DistanceMap, points: np.ndarray) -> np.ndarray:  # [N, 3] metres -> [N] bool
    return distances.at(points) <= _RADIUS


def _raised(frame: Frame, storey: int) -> Frame:
    pose = frame.world_from_camera.copy()
    pose[2, 3] += STOREY * storey
    return replace(frame, world_from_camera=pose)


def _measure(
    mapper: Mapper, probe_frames: Sequence[Frame], scoring: PinholeCamera, candidates: np.ndarray
) -> GrowthRow:
    memory = resident_mb()
    keyframes, gaussians = len(mapper.keyframes), mapper.map.count
    scoring_ms = processor_ms(lambda: mapper.render_depth_alpha(scoring, candidates))
    trial = copy.deepcopy(mapper)
    events, decisions = [], []
    trial.observe(probe_frames[0])  # not timed, since the arrays of a copied map may have to grow
    for frame in probe_frames:
        events.append(processor_ms(partial(trial.observe, frame)))
        decisions.append(processor_ms(trial.keyframe_psnr))
    return GrowthRow(
        keyframes=keyframes,
        gaussians=gaussians,
        in_view=_median_in_view(mapper, probe_frames),
        event_ms=statistics.median(events),
        decision_ms=statistics.median(decisions),
        scoring_ms=scoring_ms,
        memory_mb=memory,
    )


def _compare(small: Mapper, large: Mapper, probe_frames: Sequence[Frame], rounds: int = 3) -> GrowthPair:
    """Time mapping events and decisions with a small and a large map on the same frames, in direct succession.

    Every round begins with new copies of the two mappers.
    """
    events, decisions = [], []
    for _ in range(rounds):
        trials = [copy.deepcopy(mapper) for mapper in (small, large)]
        for trial in trials:
            trial.observe(probe_frames[0])  # not timed, since the arrays of a copied map may have to grow
        for number, frame in enumerate(probe_frames):
            order = (0, 1) if number % 2 else (1, 0)  # 0: small map, 1: large map; the order alternates
            event, decision = {}, {}
            for size in order:
                event[size] = processor_ms(partial(trials[size].observe, frame))
            for size in order:
                decision[size] = processor_ms(trials[size].keyframe_psnr)
            events.append(event[1] / event[0])
            decisions.append(decision[1] / decision[0])
    both = (small, large)
    counts = [_median_in_view(mapper, probe_frames) for mapper in both]
    return GrowthPair(
        keyframes=(len(small.keyframes), len(large.keyframes)),
        gaussians=(small.map.count, large.map.count),
        in_view=(counts[0], counts[1]),
        pairs=len(events),
        event_ratio=quartiles(events),
        decision_ratio=quartiles(decisions),
    )


def quartiles(values: Sequence[float]) -> tuple[float, float, float]:
    """Return the lower quartile, the median and the upper quartile of ``values``."""
    low, middle, high = np.percentile(values, (25, 50, 75)).tolist()
    return low, middle, high


def _median_in_view(mapper: Mapper, frames: Sequence[Frame]) -> int:
    return int(np.median([gaussians_in_view(mapper.map.parameters[:, : mapper.map.count], f) for f in frames]))


def gaussians_in_view(
    parameters: np.ndarray,  # [14, n] parameters of n Gaussians
    frame: Frame,
) -> int:
    """Return the number of Gaussians whose centre projects into the frame's image, including occluded ones."""
    camera = frame.camera
    pose = invert_rigid(frame.world_from_camera).astype(np.float32)
    x, y, z = pose[:3, :3] @ parameters[MEAN] + pose[:3, 3:]
    safe = np.maximum(z, 1e-6)
    u, v = camera.fx * x / safe + camera.cx, camera.fy * y / safe + camera.cy
    return int(np.count_nonzero((z > 0) & (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)))


def resident_mb() -> float:
    """Return the resident memory of this process in MB; on systems without ``/proc``, its maximum so far."""
    try:
        pages = int(Path("/proc/self/statm").read_text(encoding="utf-8").split()[1])
        return pages * os.sysconf("SC_PAGE_SIZE") / 1e6
    except (OSError, ValueError, IndexError):
        import resource

        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1e6 if sys.platform == "darwin" else 1e3)


def processor_ms(action: Callable[[], object]) -> float:
    """Return the processor time of a call of ``action`` in milliseconds."""
    before = time.process_time()
    action()
    return 1e3 * (time.process_time() - before)


@dataclass(frozen=True)
class Growth:
    """Measure the cost of one place while the map grows elsewhere to millions of Gaussians, and the map's memory."""

    scene: str | None = None
    """Map this scene; by default an apartment."""
    out: str | None = None
    """Write growth.jpg and growth.json to this folder; by default print only."""
    quick: bool = False
    """Run a small version, which shows only that the benchmark works."""

    def run(self) -> int:
        """Measure, print a table, and return 0."""
        console = make_console()
        rows = _growth(console, self.scene, quick=self.quick, out=self.out)
        print_rows(console, rows, "cost of one place while the map grows elsewhere")
        return 0


def _growth(console: Console, spec: str | None, *, quick: bool, out: str | None) -> list[dict[str, Any]]:
    from activestructure_gym.mapping import Mapper, MapperConfig
    from activestructure_gym.scenes.library import load_scene
    from benchmarks import copies
    from benchmarks.mapping_figures import plot_growth

    checkpoints, pair = ((2, 4, 27), (4, 27)) if quick else (CHECKPOINTS, PAIR)
    size, scored, probes = ((96, 54), 8, 2) if quick else (SIZE, SCORED, 15)
    with console.status("loading the scene"):
        scene = load_scene(spec or ("box" if quick else SCENE))
    mapper = Mapper(MapperConfig(), np.random.default_rng(0))
    with measuring(console, growth_steps(checkpoints)) as advance:
        measured, compared = run_growth_benchmark(
            scene, mapper, checkpoints=checkpoints, size=size, scored=scored, probes=probes, pair=pair, advance=advance
        )
    rows = [asdict(row) for row in measured]
    counts, keyframes = ((30_000,), (2, 20)) if quick else (copies.COUNTS, copies.KEYFRAMES)
    with measuring(console, 2 * len(counts)) as advance:
        among = copies.run_copies_benchmark(
            scene,
            Mapper(MapperConfig(), np.random.default_rng(0)),
            counts=counts,
            keyframes=keyframes,
            size=size,
            probes=probes,
            advance=advance,
        )
    for row in among:
        low, middle, high = row.event_ratio
        console.print(
            f"an event among copies ({row.where}), {row.gaussians[1]:,} Gaussians, costs {middle:.2f} "
            f"[{low:.2f}, {high:.2f}] times that with {row.gaussians[0]:,} ({row.pairs} pairs; "
            f"{row.event_ms[0]:.0f} and {row.event_ms[1]:.0f} ms)"
        )
    console.print(f"the map's arrays take {among[-1].mb_per_million:.0f} MB per million Gaussians of capacity")
    for name, (low, middle, high) in (("an event", compared.event_ratio), ("a decision", compared.decision_ratio)):
        console.print(
            f"{name} with {compared.keyframes[1]} keyframes costs {middle:.2f} [{low:.2f}, {high:.2f}] times that with "
            f"{compared.keyframes[0]} ({compared.pairs} pairs)"
        )
    if out is not None:
        settings = {"scene": scene.name, "size": size, "scored": scored, "pair": asdict(compared)}
        settings["copies"] = [asdict(row) for row in among]
        folder = write_rows(out, "growth.json", settings, rows)
        plot_growth(measured, folder / "growth.jpg", title="One place, observed again while the map grows elsewhere")
        console.print(f"written: {escape(str(folder / 'growth.jpg'))}, {escape(str(folder / 'growth.json'))}")
    return rows


if __name__ == "__main__":
    sys.exit(run(Growth))
