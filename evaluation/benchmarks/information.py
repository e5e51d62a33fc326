"""Measure the time per decision that `KeyframeInformation` needs to update the Fisher information of all keyframes.

The time should not grow with the number of keyframes. The map is that of the rasteriser benchmark's workload W4: 50,000
Gaussians seeded in a furnished room. The keyframes are images of 80 x 60 pixels from inside the room. Between two
decisions 200 Gaussians are removed and 200 added. FisherRF's method is timed for comparison: it computes the
information of all keyframes again.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Sequence

import numpy as np

from activestructure_gym.evaluation.benchmarks.workload import make_workload
from activestructure_gym.features.keyframe_information import RENDERS, KeyframeInformation
from activestructure_gym.geometry import se3_exp
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.mapping.gaussian_map import GaussianMap

CHECKPOINTS = (10, 20, 50, 100, 200)  # numbers of keyframes
_CHANGED = 200  # number of Gaussians that are removed and added between two decisions


def run_information_benchmark(
    *,
    checkpoints: Sequence[int] = CHECKPOINTS,  # numbers of keyframes
    repeats: int = 9,  # number of timed updates
    progress: Callable[[str], None] = lambda line: None,
) -> list[dict]:
    """Return one row per number of keyframes; times are processor times in ms.

    A row holds:

    - ``keyframes``, ``gaussians``: their numbers
    - ``decision_ms``, ``low_ms``, ``high_ms``: median and quartiles of the time of `KeyframeInformation.update`
    - ``all_ms``: time to compute the information of all keyframes again
    - ``stored_mb``: memory of the stored information per keyframe, in MB

    The numbers of keyframes alternate, so the load of the machine affects all of them alike.
    """
    work, rng = make_workload("W4"), np.random.default_rng(0)
    picture, depth = np.zeros((60, 80, 3), np.uint8), np.ones((60, 80), np.float32)
    keyframes = [
        Frame(picture, depth, work.poses[i % len(work.poses)] @ se3_exp(rng.normal(0.0, 0.05, 6)), work.camera)
        for i in range(max(checkpoints))
    ]
    maps, informations = [], []
    for count in checkpoints:
        progress(f"information of {count} keyframes")
        gaussians = GaussianMap(work.count)
        gaussians.append(work.parameters[:, : work.count])
        information = KeyframeInformation(gaussians)
        information.update(keyframes[:count])
        maps.append(gaussians)
        informations.append(information)
    times: list[list[float]] = [[] for _ in checkpoints]
    for _ in range(repeats):
        gone = rng.choice(work.count, _CHANGED, replace=False)
        for gaussians, information, count, own in zip(maps, informations, checkpoints, times):
            keep = np.ones(gaussians.count, dtype=bool)
            keep[gone] = False
            block = gaussians.parameters[:, gone].copy()
            gaussians.keep(keep)
            gaussians.append(block)
            own.append(_processor_ms(lambda: information.update(keyframes[:count], renders=RENDERS)))  # noqa: B023
    rows = []
    for gaussians, information, count, own in zip(maps, informations, checkpoints, times):
        low, median, high = statistics.quantiles(own, n=4) if len(own) > 1 else own * 3
        whole = _processor_ms(lambda: KeyframeInformation(gaussians).update(keyframes[:count]))  # noqa: B023
        rows.append({
            "keyframes": count, "gaussians": gaussians.count, "decision_ms": median, "low_ms": low, "high_ms": high,
            "all_ms": whole, "stored_mb": information.megabytes,
        })  # fmt: skip
    return rows


def _processor_ms(action: Callable[[], object]) -> float:
    start = time.process_time()
    action()
    return 1e3 * (time.process_time() - start)
