"""Measure the GPU backends next to the CPU: agreement on real maps, times, and whole episodes (see `gpu_check.sh`)."""

from __future__ import annotations

import contextlib
import copy
import dataclasses
import time
import timeit
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch

from activestructure_gym.policies import make_env_and_policy
from activestructure_gym.sensors import make_renderer, renderer_status
from benchmarks.command import run

_SMALL = {"sensor.width": 48, "sensor.height": 28, "views.max_candidates": 12, "mapper.iterations": 2}
# Preset, frames and settings of the maps, and frames and settings of the episode; then those of a dry run.
_MAPS: Any = (
    (("default", 120, {}), ("full", 80, {}), ("paper", 30, {"mapper.keyframe_reduction": 1})),
    (("fast", 30, _SMALL),),
)
_EPISODES: Any = (300, {}), (12, _SMALL)


@dataclass
class GpuCheck:
    """Measure mapping events, scoring, pictures and rays of several maps, then play an episode by each backend."""

    out: str = "gpu_check"  # folder of page.txt
    seconds: float = 300.0  # no part begins after this time
    dry: bool = False  # on a CPU, with substitutes for gsplat's kernels (tests/splatting/gsplat_on_cpu.py)

    def run(self) -> int:
        """Run all parts, and write the page after each one; a part that fails does not stop the others."""
        from tests.splatting.gsplat_on_cpu import on_cpu

        device = "dry run on a CPU: times mean nothing" if self.dry else torch.cuda.get_device_name()
        lines = [f"# GPU check, {time.strftime('%Y-%m-%d')}: {device}, torch {torch.__version__}", ""]
        parts: list[tuple[Any, ...]] = [(_map, *one) for one in _MAPS[self.dry]]
        parts += [(_episode, name, *_EPISODES[self.dry]) for name in ("gsplat", "cpu")]
        end = time.perf_counter() + self.seconds
        with on_cpu() if self.dry else contextlib.nullcontext():
            for part, name, *others in parts:
                try:
                    line = part(name, *others) if time.perf_counter() < end else "no time left"
                except Exception as error:  # of any kind: finding it is the purpose
                    line = f"FAILED, {type(error).__name__}: {error}"
                lines.append(f"- {name}: {line}")
                print(lines[-1], flush=True)
                (Path(self.out) / "page.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")
        return int(any("FAILED" in line for line in lines))


def _map(preset: str, frames: int, settings: dict[str, Any]) -> str:
    """Compare pictures and times of a map that the CPU kernels optimised."""
    own, _ = _played(preset, frames, settings)
    frame, seen = own.mapper.keyframes[-1], (own.scoring_camera, own.candidates.world_from_camera)
    pictures, times = [], []
    for name in ("cpu", "gsplat"):
        mapper = copy.deepcopy(own.mapper)
        mapper.config = dataclasses.replace(mapper.config, backend=name)
        shown = mapper.render(frame.camera, frame.world_from_camera)
        pictures.append((shown.color, shown.depth, shown.alpha, *mapper.render_depth_alpha(*seen)))
        for call in (partial(mapper.render_depth_alpha, *seen), partial(mapper.observe, frame)):
            times.append(f"{call.func.__name__} by {name} {_milliseconds(call)}")
    worst = max(np.quantile(np.abs(one - other), 0.999) for one, other in zip(*pictures))
    for name in ("raycast", "warp") if renderer_status()["warp"] == "works" else ():
        call = partial(make_renderer(name, own.scene).render, own.sensor.camera, frame.world_from_camera)
        times.append(f"frame by {name} {_milliseconds(call)}")
    return f"{own.mapper.map.count:,} Gaussians; 99.9 % of the pixels within {worst:.0e}; ms: {', '.join(times)}"


def _episode(backend: str, frames: int, settings: dict[str, Any]) -> str:
    own, seconds = _played("paper", frames, {**settings, "mapper.backend": backend})
    score = f"{np.mean(own.mapper.keyframe_psnr(renders=None)):.2f} dB, {own.mapper.map.count:,} Gaussians"
    return f"`paper` in {seconds:.1f} s, {own.frames} frames, {score}"


def _played(preset: str, frames: int, settings: dict[str, Any]) -> tuple[Any, float]:
    """Return the reconstruction at the end of an episode of `hole_area`, and the seconds that it took."""
    options: dict[str, Any] = {"scene": "room?seed=11", "frame_budget": frames, "config": settings}
    env, policy = make_env_and_policy("hole_area", preset=preset, **options)
    policy.reset(seed=0)
    observation, _ = env.reset(seed=0)
    began, ended = time.perf_counter(), False
    while not ended:
        observation, _, terminated, truncated, _ = env.step(policy.act(observation))
        ended = terminated or truncated
    return env.get_wrapper_attr("reconstruction"), time.perf_counter() - began


def _milliseconds(call: Callable[[], Any]) -> str:
    """Return the median wall-clock time of five calls after two others; the results of a call are on the host."""
    return f"{1e3 * np.median(timeit.repeat(call, number=1, repeat=7)[2:]):.1f}"


if __name__ == "__main__":
    raise SystemExit(run(GpuCheck))
