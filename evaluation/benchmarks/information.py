"""Measure the cost per decision of the keyframes' information, which should not grow with their number.

The map is that of the rasteriser's workload W4: 50k Gaussians seeded in a furnished room. The keyframes look around in
it at the image size of candidate scoring. Between two decisions some Gaussians are removed and equally many added, as
in an episode. FisherRF's method is timed for comparison: it computes the information of all keyframes anew.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Sequence

import numpy as np

from activestructure_gym.evaluation.benchmarks.splatting import make_workload
from activestructure_gym.features.keyframe_information import RENDERS, KeyframeInformation
from activestructure_gym.geometry import se3_exp
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.mapping.gaussian_map import GaussianMap

CHECKPOINTS = (10, 20, 50, 100, 200)
_CHANGED = 200  # Gaussians that are removed, and equally many added, between two decisions


def run_information_benchmark(
    *,
    checkpoints: Sequence[int] = CHECKPOINTS,  # rising numbers of keyframes
    repeats: int = 9,
    progress: Callable[[str], None] = lambda line: None,
) -> list[dict]:
    """Return rows ``{keyframes, gaussians, decision_ms, low_ms, high_ms, all_ms, stored_mb}`` in processor ms.

    ``decision_ms`` is the median of `KeyframeInformation.update`, with quartiles ``low_ms`` and ``high_ms``.
    ``all_ms`` is the time of all keyframes anew, ``stored_mb`` the memory of their shares. The numbers of keyframes
    alternate, so that the load of the machine affects all of them.
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
