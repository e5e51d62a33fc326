"""Measure the speed of the CPU rasteriser on maps of a room.

The workloads W1, W2 and W3 time one mapping iteration: rendering, losses, backward pass and Adam. W4 times candidate
scoring: alpha and depth of 64 cameras.

Ratios of times from the same run compare machines and versions:

- ``floor_share``: ideal time divided by the measured time. The ideal time is that of the needed arithmetic at the
  measured peak of multiply-adds. For an iteration it includes the forward and backward pass, not losses and Adam.
- ``vs_torch``: time of the plain-torch renderer divided by the measured time
- ``vs_one``: time on the first thread count divided by the measured time
- ``second_pass``: time of the information of a view (`fisher`) minus time of a forward rendering, divided by the latter
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Iterable

import numpy as np

from activestructure_gym.compiling import kernel
from activestructure_gym.compiling.thread_team import TEAM
from activestructure_gym.errors import unknown_name
from activestructure_gym.evaluation.benchmarks.workload import SIZES, WORKLOADS, Workload, aligned_map, make_workload
from activestructure_gym.geometry import invert_rigid
from activestructure_gym.splatting import kernels, layout
from activestructure_gym.splatting.cpu import LossWeights, mapping_step, render, render_depth_alpha
from activestructure_gym.splatting.fisher import view_information
from activestructure_gym.splatting.simd import LANES
from activestructure_gym.splatting.workspace import PooledWorkspace, aligned_zeros, inverse_of_pose

# Floating-point operations per needed (pixel, Gaussian) pair; a multiply-add counts as two. Forward: offsets 2,
# exponent 8, exp2 13, limits 2, transmittance 3, sums 8. Backward: the first 25 of these again, and 40 more.
_FLOPS_FORWARD, _FLOPS_BACKWARD = 36, 65
_INFORMATION = "information"  # task: forward rendering, then a second pass for the information of the view
_IN_A_ROW = 5  # consecutive timed runs per repetition, since a mapping event has several iterations
_RATES = np.zeros(14, np.float32)  # learning rates of 0, with which the map does not change


def run_splatting_benchmark(
    workloads: Iterable[str] = WORKLOADS,
    *,
    repeats: int = 15,
    threads: Iterable[int] | None = None,
    baseline: bool = True,
    progress: Callable[[str], None] = lambda line: None,
) -> list[dict]:
    """Return one row per workload, task and thread count.

    A row holds:

    - ``workload``, ``task``, ``threads``, ``repeats``
    - ``visible``, ``pairs_per_pixel``: visible Gaussians and needed (pixel, Gaussian) pairs, means over the views
    - ``median_ms``, ``low_ms``, ``high_ms``, ``best_ms``: median, quartiles and minimum of the repetitions, wall time
    - ``cpu_ms``: median processor time of all threads, which depends less on the load of the machine
    - ``floor_share``, ``vs_torch``, ``vs_one``: ratios of medians, NaN if not defined
    - ``second_pass``: quartiles by processor time, for the task "information", else None

    A repetition is the mean of five consecutive runs after a run that is not timed, so the caches hold the map, as in a
    mapping event. For plain torch, a repetition is one run. All tasks and thread counts alternate, so the load of the
    machine affects all of them alike. ``baseline`` adds two kinds of tasks: the plain-torch renderer (names with ",
    torch", at most 5 repetitions, since it is a hundred times slower), and this rasteriser in torch's autograd.

    Raise `InputError` for an unknown workload.
    """
    names, counts = tuple(workloads), tuple(threads) if threads is not None else (1, 2)
    for name in names:
        if name not in SIZES:
            raise unknown_name("splatting workload", name, SIZES)
    rows = []
    for name in names:
        progress(f"splatting workload {name}")
        work = make_workload(name)
        views = work.poses if name == "W4" else work.poses[:1]
        visible, pairs = np.mean([count_work(work, pose) for pose in views], axis=0)
        tasks = _tasks(name, work)
        if baseline:
            from activestructure_gym.evaluation.benchmarks.torch_tasks import torch_tasks

            tasks |= torch_tasks(name, work)
        few = {task: min(repeats, 5) if task.endswith(", torch") else repeats for task in tasks}
        wall, busy, peaks = _measure(tasks, counts, few, repeats)
        for task in tasks:
            flops = _flops(task) * pairs * len(views)
            for count in counts:
                own = wall[task, count]
                low, median, high = statistics.quantiles(own, n=4) if len(own) > 1 else own * 3
                rival = wall.get((f"{_BASELINES.get(task, '')}, torch", count))
                rows.append({
                    "workload": name, "visible": round(visible), "pairs_per_pixel": pairs / work.target_depth.size,
                    "task": task, "threads": count, "median_ms": median, "low_ms": low, "high_ms": high,
                    "best_ms": min(own), "cpu_ms": statistics.median(busy[task, count]),
                    "floor_share": _floor_share(flops, peaks[task, count], own) if flops else float("nan"),
                    "vs_torch": statistics.median(rival) / median if rival else float("nan"),
                    "vs_one": statistics.median(wall[task, counts[0]]) / median,
                    "second_pass": _second_pass(busy[task, count], busy["forward", count])
                    if task == _INFORMATION else None,
                    "repeats": len(own),
                })  # fmt: skip
    return rows


def _floor_share(flops: float, peaks: list[float], times_ms: list[float]) -> float:
    """Return ``floor_share``: the median over repetitions of the ideal time divided by the measured time.

    ``flops`` is the number of operations of a run. ``peaks`` are flops per second, measured just before each repetition
    since clock rates change.
    """
    return statistics.median(1e3 * flops / peak / time_ms for peak, time_ms in zip(peaks, times_ms))


def _second_pass(whole: list[float], forward: list[float]) -> tuple[float, ...]:
    """Return ``second_pass``: quartiles over repetitions of (``whole`` - ``forward``) / ``forward`` of the same round.

    ``whole`` and ``forward`` are times of the task "information" and of the task "forward".
    """
    shares = [(own - first) / first for own, first in zip(whole, forward)]
    return tuple(statistics.quantiles(shares, n=4)) if len(shares) > 1 else tuple(shares) * 3


def _measure(tasks, counts, few, repeats):
    """Time all tasks: return wall ms, processor ms and peak flops per second of each repetition, by (task, threads).

    ``few`` is the number of repetitions of each task, at most ``repeats``. A first round is not timed.
    """
    keys = [(task, count) for task in tasks for count in counts]
    wall: dict[tuple[str, int], list[float]] = {key: [] for key in keys}
    busy: dict[tuple[str, int], list[float]] = {key: [] for key in keys}
    peaks: dict[tuple[str, int], list[float]] = {key: [] for key in keys}
    for repeat in range(-1, repeats):
        for task, action in tasks.items():
            if repeat >= few[task]:
                continue
            for count in counts:
                runs = 1
                peak = multiply_add_peak(count, tries=2) if _flops(task) else float("nan")
                if not task.endswith(", torch"):
                    action(count)  # not timed: it brings the map into the caches
                    runs = _IN_A_ROW
                start, busy_start = time.perf_counter(), time.process_time()
                for _ in range(runs):
                    action(count)
                if repeat >= 0:  # the first round is a warm-up
                    wall[task, count].append(1e3 / runs * (time.perf_counter() - start))
                    busy[task, count].append(1e3 / runs * (time.process_time() - busy_start))
                    peaks[task, count].append(peak)
            if task.endswith((", torch", "autograd")):
                time.sleep(0.02)  # torch's idle threads spin for a while, which would slow the next task
    return wall, busy, peaks


# The plain-torch task with which each task is compared in ``vs_torch``; its name there ends with ", torch".
_BASELINES = {
    "iteration, L1": "iteration, L1", "iteration, L1 + SSIM": "iteration, L1",
    "iteration, L1, through autograd": "iteration, L1", "score 64 views": "score 64 views",
}  # fmt: skip


def _flops(task: str) -> int:
    """Return the floating-point operations of a task per needed (pixel, Gaussian) pair; 0 if not counted."""
    if task.endswith(", torch") or task == _INFORMATION:
        return 0
    return _FLOPS_FORWARD if task in ("forward", "score 64 views") else _FLOPS_FORWARD + _FLOPS_BACKWARD


def multiply_add_peak(threads: int, *, tries: int = 6) -> float:
    """Measure the peak flops per second of 16-lane multiply-adds on ``threads`` threads, as the best of ``tries``."""
    pieces, rounds = 8 * threads, 20_000
    values = aligned_zeros(LANES * (1 + pieces))
    values[:LANES] = 0.5
    best = float("inf")
    for _ in range(tries):
        tickets = np.zeros(1, np.int64)
        start = time.perf_counter()
        TEAM.run(kernels.multiply_add, (tickets, rounds, pieces, values), threads)
        best = min(best, time.perf_counter() - start)
    return 7 * 2 * LANES * pieces * rounds / best  # seven chains, two operations each


def count_work(work: Workload, world_from_camera: np.ndarray) -> tuple[int, int]:
    """Return the numbers of visible Gaussians and of needed (pixel, Gaussian) pairs for one camera pose.

    A pair is needed if the Gaussian's alpha at the pixel is at least 1/255, and the Gaussians in front leave more
    transmittance than `layout.MIN_TRANSMITTANCE`.
    """
    pooled = PooledWorkspace()
    workspace = pooled.workspace
    workspace.render(work.parameters, work.count, work.camera, invert_rigid(world_from_camera), threads=1, keep=False)
    visible = np.unpackbits(workspace.visible[: -(-work.count // LANES)].view(np.uint8)).sum()
    splats = workspace.entries[layout.SORTED_SPLAT]
    return int(visible), _count_pairs(workspace.grid, workspace.tile_start, splats, workspace.records)


@kernel
def _count_pairs(grid, tile_start, entries, records):
    pairs = 0
    for tile in range(grid[layout.TILES_X] * grid[layout.TILES_Y]):
        top, left = layout.TILE * (tile // grid[layout.TILES_X]), layout.TILE * (tile % grid[layout.TILES_X])
        for row in range(top, min(top + layout.TILE, grid[layout.HEIGHT])):
            for column in range(left, min(left + layout.TILE, grid[layout.WIDTH])):
                rest = 1.0
                for entry in range(tile_start[tile], tile_start[tile + 1]):
                    base = layout.RECORD * np.int64(entries[entry] & np.uint64(0xFFFFFFFF))
                    dx, dy = column + 0.5 - records[base + layout.U], row + 0.5 - records[base + layout.V]
                    across = records[base + layout.L00] * dx + records[base + layout.L01] * dy
                    down = records[base + layout.L11] * dy
                    power = records[base + layout.LOG_OPACITY] - across * across - down * down
                    if power >= -layout.LOG2_255:
                        rest *= 1.0 - min(2.0**power, 0.999)
                        if rest <= layout.MIN_TRANSMITTANCE:
                            break
                        pairs += 1
    return pairs


def _tasks(name: str, work: Workload) -> dict[str, Callable[[int], object]]:
    if name == "W4":
        return {
            "score 64 views": lambda threads: render_depth_alpha(
                work.parameters, work.count, work.camera, work.poses, threads=threads
            )
        }
    parameters, first, second = (aligned_map(work.parameters.shape) for _ in range(3))
    parameters[:] = work.parameters

    def step(weights: LossWeights, threads: int) -> None:
        mapping_step(
            parameters, first, second, work.count, work.camera, work.poses[0], work.target_rgb, work.target_depth,
            weights=weights, learning_rates=_RATES, threads=threads,
        )  # fmt: skip

    pooled, gradient = PooledWorkspace(), np.zeros_like(work.parameters)
    workspace = pooled.workspace
    height, width = work.target_depth.shape
    images = (np.ones((height, width, 3), np.float32), *np.ones((2, height, width), np.float32))

    def there_and_back(threads: int) -> None:
        _ = pooled  # this reference keeps the workspace alive
        workspace.render(work.parameters, work.count, work.camera, inverse_of_pose(work.poses[0]), threads=threads)
        workspace.set_gradient_images(*images)
        workspace.backward(np.zeros(layout.RATES, np.float32), gradient, gradient, gradient)

    return {
        "forward + backward": there_and_back,
        "forward": lambda threads: render(work.parameters, work.count, work.camera, work.poses[0], threads=threads),
        _INFORMATION: lambda threads: next(
            view_information(work.parameters, work.count, work.camera, work.poses[0], threads=threads)
        ),
        "iteration, L1": lambda threads: step(LossWeights(l1_share=1.0), threads),
        "iteration, L1 + SSIM": lambda threads: step(LossWeights(), threads),
    }
