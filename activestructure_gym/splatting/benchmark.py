"""How fast the CPU rasteriser is here: real seeded inputs, warm, medians with spread.

Workloads (sizes of ``../shared/research/rasteriser.md``): Gaussians seeded as disks from the RGB-D pixels of six views
of a furnished box room, and one of those views as the target.
W1 160x120 / 20k, W2 320x240 / 80k, W3 640x480 / 300k: one fused mapping iteration. W4: alpha and depth of 64 cameras at
80x60 over 50k Gaussians (candidate scoring).

Next to the times stands ``floor_share``: the time the needed arithmetic would take at the multiply-add peak measured in
the same run, over the time taken. It compares machines and versions where milliseconds do not.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from numba import njit

from activestructure_gym.errors import unknown_name
from activestructure_gym.geometry import PinholeCamera, invert_rigid, look_along
from activestructure_gym.splatting import kernels
from activestructure_gym.splatting.cpu import LossWeights, mapping_step, render, render_depth_alpha
from activestructure_gym.splatting.crew import CREW
from activestructure_gym.splatting.workspace import Lease, aligned_zeros

_SIZES = {"W1": (160, 120, 20_000), "W2": (320, 240, 80_000), "W3": (640, 480, 300_000), "W4": (80, 60, 50_000)}
# Per needed pair, a multiply-add as two: offsets 2, exponent 8, exp2 13, limits 2, transmittance 3, sums 8; backward
# the first 25 again and 40.
_FLOPS_FORWARD, _FLOPS_BACKWARD = 36, 65
_RATES = np.zeros(14, np.float32)  # all the arithmetic, but every repetition meets the same map
_ROOM = np.array([[0.0, 0.0, 0.0], [6.0, 5.0, 2.8]])
_BOXES = np.array([
    [[0.5, 0.4, 0.0], [1.5, 1.9, 0.7]], [[4.6, 0.3, 0.0], [5.6, 1.1, 1.9]], [[2.4, 4.2, 0.0], [4.0, 4.9, 0.9]],
    [[0.2, 3.9, 0.0], [0.9, 4.8, 2.0]], [[5.0, 3.0, 0.0], [5.8, 4.4, 0.5]], [[2.7, 0.2, 0.0], [3.5, 0.8, 1.1]],
])  # fmt: skip


@dataclass(frozen=True)
class Workload:
    """A map and what is asked of it."""

    parameters: np.ndarray  # [14, capacity] float32
    count: int
    camera: PinholeCamera
    poses: np.ndarray  # [C, 4, 4] world_from_camera
    target_rgb: np.ndarray  # [H, W, 3] float32
    target_depth: np.ndarray  # [H, W] float32


def make_workload(name: str, seed: int = 0) -> Workload:
    """Build one of W1 to W4; the same for every call."""
    if name not in _SIZES:
        raise unknown_name("splatting workload", name, _SIZES)
    width, height, count = _SIZES[name]
    rng = np.random.default_rng(seed)
    camera = PinholeCamera.from_size(width, height)
    # W1 to W3 look where neighbouring views have seeded too; W4 looks all around.
    poses = _poses(np.radians([0, 45, -45, 90, -90, 135]) if name != "W4" else np.arange(64) / 32 * np.pi, rng)
    sources = poses if name != "W4" else poses[::11]
    per_view = -(-count // 6)
    # W4 is seeded at a density that suits its count, not from its own small images.
    seeding = camera if name != "W4" else PinholeCamera.from_size(128, 96)
    blocks = [_seed(seeding, pose, per_view, rng) for pose in sources]
    live = np.concatenate(blocks, axis=1)[:, :count]
    parameters = np.zeros((14, -(-count // 16) * 16), np.float32)
    parameters[:, :count] = live
    rgb, depth, _ = _see(camera, poses[0])
    return Workload(parameters, count, camera, poses, rgb.astype(np.float32), depth.astype(np.float32))


def run_splatting_benchmark(
    workloads: Iterable[str] = ("W1", "W2", "W4"),
    *,
    repeats: int = 15,
    threads: Iterable[int] | None = None,
    baseline: bool = False,
    progress: Callable[[str], None] = lambda line: None,
) -> list[dict]:
    """Rows ``{workload, task, threads, median_ms, low_ms, high_ms, best_ms, cpu_ms, floor_share, repeats}``.

    Low and high are the quartiles, ``cpu_ms`` the median processor time of all threads together (what is left to look
    at on a machine shared with others); ``floor_share`` is nan where the floor is not defined (losses, Adam).
    ``baseline`` adds rows of the batched plain-torch renderer (tasks ending in ", torch"; W4 is left out there).
    The thread counts are alternated within every repetition, so that a busy spell of the machine hits all of them.
    """
    counts = tuple(threads) if threads is not None else (1, 2)
    rows = []
    for name in workloads:
        progress(f"splatting workload {name}")
        work = make_workload(name)
        views = work.poses if name == "W4" else work.poses[:1]
        pairs = sum(needed_pairs(work, pose) for pose in views)
        floors = dict.fromkeys(("forward", "score 64 views"), _FLOPS_FORWARD * pairs)
        floors["forward + backward"] = (_FLOPS_FORWARD + _FLOPS_BACKWARD) * pairs
        peaks = {count: multiply_add_peak(count) for count in counts}
        tasks = _tasks(name, work)
        if baseline and name != "W4":
            tasks["iteration, L1, torch"] = _torch_iteration(work)
        for task, action in tasks.items():
            times: dict[int, list[float]] = {count: [] for count in counts}
            work_times: dict[int, list[float]] = {count: [] for count in counts}
            for count in counts:
                action(count)  # warm
            for _ in range(repeats):
                for count in counts:
                    start, work_start = time.perf_counter(), time.process_time()
                    action(count)
                    times[count].append(1e3 * (time.perf_counter() - start))
                    work_times[count].append(1e3 * (time.process_time() - work_start))
            for count in counts:
                low, median, high = statistics.quantiles(times[count], n=4)
                floor_ms = 1e3 * floors.get(task, float("nan")) / peaks[count]
                rows.append({
                    "workload": name, "task": task, "threads": count, "median_ms": median, "low_ms": low,
                    "high_ms": high, "best_ms": min(times[count]), "cpu_ms": statistics.median(work_times[count]),
                    "floor_share": floor_ms / median, "repeats": repeats,
                })  # fmt: skip
    return rows


def multiply_add_peak(threads: int) -> float:
    """Flops per second of 16-lane multiply-adds on so many threads, the best of a few tries."""
    pieces, rounds = 8 * threads, 20_000
    values = aligned_zeros(kernels.LANES * (2 + pieces))
    values[: 2 * kernels.LANES] = 0.5
    best = float("inf")
    for _ in range(6):
        tickets = np.zeros(1, np.int64)
        start = time.perf_counter()
        CREW.run(kernels.multiply_add, (tickets, rounds, pieces, values), threads)
        best = min(best, time.perf_counter() - start)
    return 10 * 2 * kernels.LANES * pieces * rounds / best


def needed_pairs(work: Workload, world_from_camera: np.ndarray) -> int:
    """How many (pixel, Gaussian) pairs enter the picture: the pixel still open and alpha at least 1/255."""
    workspace = Lease().workspace
    workspace.render(work.parameters, work.count, work.camera, invert_rigid(world_from_camera), threads=1)
    splats = workspace.entries[kernels.SORTED_SPLAT]
    return _count_pairs(workspace.grid, workspace.tile_start, splats, workspace.records)


@njit  # not cached on disk: it depends on layouts in another file, which numba's cache would not notice
def _count_pairs(grid, tile_start, entries, records):
    pairs = 0
    for tile in range(grid[kernels.TILES_X] * grid[kernels.TILES_Y]):
        top, left = kernels.TILE * (tile // grid[kernels.TILES_X]), kernels.TILE * (tile % grid[kernels.TILES_X])
        for row in range(top, min(top + kernels.TILE, grid[kernels.HEIGHT])):
            for column in range(left, min(left + kernels.TILE, grid[kernels.WIDTH])):
                rest = 1.0
                for entry in range(tile_start[tile], tile_start[tile + 1]):
                    base = kernels.RECORD * np.int64(entries[entry] & np.uint64(0xFFFFFFFF))
                    dx, dy = column + 0.5 - records[base + kernels.U], row + 0.5 - records[base + kernels.V]
                    across = records[base + kernels.L00] * dx + records[base + kernels.L01] * dy
                    down = records[base + kernels.L11] * dy
                    power = records[base + kernels.LOG_OPACITY] - across * across - down * down
                    if power >= -kernels.LOG2_255:
                        rest *= 1.0 - min(2.0**power, 0.999)
                        if rest <= kernels.MIN_TRANSMITTANCE:
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
    parameters = work.parameters.copy()
    first, second = np.zeros_like(parameters), np.zeros_like(parameters)

    def step(weights: LossWeights, threads: int) -> None:
        mapping_step(
            parameters, first, second, work.count, work.camera, work.poses[0], work.target_rgb, work.target_depth,
            weights, _RATES, threads=threads,
        )  # fmt: skip

    workspace, gradient = Lease().workspace, np.zeros_like(work.parameters)
    height, width = work.target_depth.shape
    images = (np.ones((height, width, 3), np.float32), *np.ones((2, height, width), np.float32))

    def there_and_back(threads: int) -> None:
        workspace.render(work.parameters, work.count, work.camera, invert_rigid(work.poses[0]), threads=threads)
        workspace.set_gradient_images(*images)
        workspace.backward(np.zeros(18, np.float32), gradient, gradient, gradient)

    return {
        "forward + backward": there_and_back,
        "forward": lambda threads: render(work.parameters, work.count, work.camera, work.poses[0], threads=threads),
        "iteration, L1": lambda threads: step(LossWeights(l1_share=1.0), threads),
        "iteration, L1 + SSIM": lambda threads: step(LossWeights(), threads),
    }


def _torch_iteration(work: Workload) -> Callable[[int], None]:
    """Render, L1 on colour and depth, backward and Adam in plain torch; the learning rates are 0 here too."""
    import torch

    from activestructure_gym.splatting.torch_tiles import rasterize_torch_tiles

    live = torch.from_numpy(work.parameters[:, : work.count].copy())
    means, quaternions, log_scales, opacity_logits, colors = (
        group.contiguous().requires_grad_() for group in (live[:3].T, live[3:7].T, live[7:10].T, live[10], live[11:].T)
    )
    optimizer = torch.optim.Adam([means, quaternions, log_scales, opacity_logits, colors], lr=0.0, fused=True)
    pose = torch.from_numpy(invert_rigid(work.poses[0]).astype(np.float32))
    target, depth = torch.from_numpy(work.target_rgb), torch.from_numpy(work.target_depth)

    def iteration(threads: int) -> None:
        before = torch.get_num_threads()
        torch.set_num_threads(threads)
        try:
            picture = rasterize_torch_tiles(means, quaternions, log_scales, opacity_logits, colors, pose, work.camera)
            seen = picture[..., 4].detach() > 0.5
            error = (picture[..., 3][seen] / picture[..., 4][seen] - depth[seen]).abs().mean()
            loss = 0.5 * (picture[..., :3] - target).abs().mean() + error
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
        finally:
            torch.set_num_threads(before)

    return iteration


def _poses(yaws: np.ndarray, rng: np.random.Generator) -> np.ndarray:  # [C] radians -> [C, 4, 4]
    """Cameras around the middle of the room."""
    poses = []
    for yaw in yaws:
        position = np.array([3.0, 2.5, 1.4]) + rng.uniform(-0.6, 0.6, 3) * [1.0, 1.0, 0.4]
        poses.append(look_along(position, np.array([np.cos(yaw), np.sin(yaw), rng.uniform(-0.3, 0.1)])))
    return np.stack(poses)


def _see(camera: PinholeCamera, pose: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Colour ``[H, W, 3]``, depth ``[H, W]`` and normals ``[H, W, 3]`` of the box room, by slabs."""
    directions = camera.rays().astype(np.float64) @ pose[:3, :3].T
    origin = pose[:3, 3]
    walls = np.where(directions > 0, _ROOM[1] - origin, _ROOM[0] - origin) / directions
    axis, depth = walls.argmin(axis=-1), walls.min(axis=-1)
    for low, high in _BOXES:
        a, b = (low - origin) / directions, (high - origin) / directions
        near, far = np.minimum(a, b), np.maximum(a, b).min(axis=-1)
        enters = near.max(axis=-1)
        hit = (enters > 0) & (enters < far) & (enters < depth)
        depth, axis = np.where(hit, enters, depth), np.where(hit, near.argmax(axis=-1), axis)
    normals = np.eye(3)[axis] * -np.sign(np.take_along_axis(directions, axis[..., None], axis=-1))
    points = origin + directions * depth[..., None]
    waves = np.sin(points @ np.array([[9.0, 4.0, 2.0], [3.0, 11.0, 5.0], [6.0, 2.0, 13.0]]))
    return 0.5 + 0.2 * normals + 0.25 * waves, depth, normals


def _seed(camera: PinholeCamera, pose: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:  # [14, count]
    """Disks on the surface at ``count`` pixels in raster order, footprint sigma 1.0 to 1.5 px."""
    rgb, depth, normals = _see(camera, pose)
    pixels = np.sort(rng.choice(depth.size, count, replace=count > depth.size))
    z = depth.reshape(-1)[pixels]
    points = pose[:3, 3] + (camera.rays().reshape(-1, 3)[pixels] @ pose[:3, :3].T) * z[:, None]
    normal = normals.reshape(-1, 3)[pixels]
    quaternion = np.concatenate([1.0 + normal[:, 2:], np.cross([0.0, 0.0, 1.0], normal)], axis=1)
    quaternion[normal[:, 2] < -0.5] = [0.0, 1.0, 0.0, 0.0]  # facing down: half a turn
    sigma = rng.uniform(1.0, 1.5, count) * z / camera.fx
    opacity = rng.uniform(0.5, 0.95, count)
    return np.concatenate([
        points.T, quaternion.T, np.log(sigma)[None], np.log(sigma)[None], np.log(0.1 * sigma)[None],
        np.log(opacity / (1.0 - opacity))[None], rgb.reshape(-1, 3)[pixels].T,
    ])  # fmt: skip
