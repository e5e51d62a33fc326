"""Define the tasks of the splatting benchmark that use torch."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
import torch

from activestructure_gym.evaluation.benchmarks.torch_tiles import rasterize_torch_tiles
from activestructure_gym.geometry import invert_rigid
from activestructure_gym.splatting.api import parameter_rows, rasterize

if TYPE_CHECKING:
    from activestructure_gym.evaluation.benchmarks.workload import Workload


def torch_tasks(name: str, work: Workload) -> dict[str, Callable[[int], object]]:
    """Return the tasks that use torch: the plain-torch renderer, and this rasteriser in torch's autograd.

    Both use the loss and the optimiser of torch.
    """
    live = torch.from_numpy(work.parameters[:, : work.count].copy())
    columns = (live[:3].T, live[3:7].T, live[7:10].T, live[10], live[11:].T)
    means, quaternions, log_scales, logits, colors = (group.contiguous().requires_grad_() for group in columns)
    optimizer = torch.optim.Adam([means, quaternions, log_scales, logits, colors], lr=0.0, fused=True)
    # Both renderers get their fastest layout: plain torch a row per Gaussian, this rasteriser a row per parameter.
    rows = [group.requires_grad_() for group in parameter_rows(torch.from_numpy(work.parameters.copy()))]
    of_rows = torch.optim.Adam(rows, lr=0.0, fused=True)
    poses = torch.from_numpy(invert_rigid(work.poses).astype(np.float32))
    target, measured = torch.from_numpy(work.target_rgb), torch.from_numpy(work.target_depth)

    def score() -> None:
        with torch.no_grad():
            for pose in poses:
                rasterize_torch_tiles(
                    means, quaternions, log_scales, logits, colors, pose, work.camera, with_color=False
                )

    def descend(color: torch.Tensor, depth: torch.Tensor, alpha: torch.Tensor, optimizer: torch.optim.Adam) -> None:
        seen = alpha.detach() > 0.5
        error = torch.where(seen, depth / alpha.clamp_min(0.5) - measured, 0.0).abs().mean()
        optimizer.zero_grad()
        (0.5 * (color - target).abs().mean() + error).backward()
        optimizer.step()

    def iteration() -> None:
        picture = rasterize_torch_tiles(means, quaternions, log_scales, logits, colors, poses[0], work.camera)
        descend(picture[..., :3], picture[..., 3], picture[..., 4], optimizer)

    def through_autograd(threads: int) -> None:
        mean_rows, quaternion_rows, scale_rows, logit_row, color_rows = rows
        seen = rasterize(
            mean_rows.T, quaternion_rows.T, scale_rows.T, logit_row, color_rows.T, camera_from_world=poses[0],
            camera=work.camera, backend="cpu", threads=threads,
        )  # fmt: skip
        descend(seen.color, seen.depth, seen.alpha, of_rows)

    def on(threads: int, action: Callable[[], None]) -> None:
        before = torch.get_num_threads()
        torch.set_num_threads(threads)
        try:
            action()
        finally:
            torch.set_num_threads(before)

    if name == "W4":
        return {"score 64 views, torch": lambda threads: on(threads, score)}
    return {
        "iteration, L1, through autograd": lambda threads: on(threads, lambda: through_autograd(threads)),
        "iteration, L1, torch": lambda threads: on(threads, iteration),
    }
