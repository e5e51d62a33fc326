"""Provide the common parts of the information features: prior, Fisher information, and the term for unseen space.

H is the Fisher information of images about the Gaussians of the map (`activestructure_gym.splatting.fisher`). It is
J^T J summed over pixels and colours, where J is the derivative of the rendered colours. H_train sums all keyframes, and
H_c is the information of one candidate; both use the candidates' camera. In functions named "of_depth" or "depth", J is
the derivative of the rendered depth.

Means, log-scales, logits and colours have different units. Every entry is therefore divided by the median of H_train
for its kind of parameter, called the unit of this kind. The prior lambda is the same fraction of the unit for all
kinds.

Sources: [fisherrf], [popgs].
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import wraps

import numpy as np

from activestructure_gym.features.context import FeatureContext
from activestructure_gym.features.hole_area import hole_area
from activestructure_gym.features.keyframe_information import COLUMNS, KeyframeInformation
from activestructure_gym.features.registry import FEATURES, Compute, Feature
from activestructure_gym.mapping import KeyframeMapper
from activestructure_gym.mapping.frustum_culling import MapParts
from activestructure_gym.splatting.fisher import DIAGONAL, ViewInformation, depth_information, view_information

LAMBDA = 1e-2  # prior that is added to H_train, as a fraction of the unit
MIN_COVERAGE = 0.05  # minimum G_cov that `adaptive` divides by; 1 is a view of unseen space alone (own choice)
WINDOW = 6.0  # metres, side length of the window around the agent in `observed_share` (HGS-Planner)
ADAPTIVE = "share of the best coverage, plus weighted information"  # unit of `adaptive` in tables
MEAN, LOG_SCALE, LOGIT, COLOR = range(4)  # kinds of parameters
_COLUMNS = (DIAGONAL[:3], DIAGONAL[3:], np.array([21]), np.array([22]))  # columns of `ViewInformation.numbers`, by kind


class _Trained:
    """Hold H_train, the Fisher information of all keyframes of an episode.

    It is updated on request, at most once between two mapping events. Its value therefore does not depend on the number
    of features that use it.
    """

    of_depth = False

    def __init__(self, context: FeatureContext) -> None:
        self._information = KeyframeInformation(
            context.mapper.persistent_map, camera=context.camera, of_depth=self.of_depth
        )
        self._event, self._found = -1, np.empty((0, COLUMNS))

    def of(self, mapper: KeyframeMapper) -> np.ndarray:  # [N, 24] float64, read-only
        if self._event != mapper.events:
            self._event, self._found = mapper.events, self._information.update(mapper.keyframes)
        return self._found


class _TrainedOfDepth(_Trained):
    of_depth = True


def trained(context: FeatureContext) -> np.ndarray:  # [N, 24] float64
    """Return H_train of the rendered colours, one row per Gaussian; columns as in `ViewInformation.numbers`."""
    return context.episode(_Trained).of(context.mapper)


def trained_of_depth(context: FeatureContext) -> np.ndarray:  # [N, 24] float64
    """Return H_train of the rendered depth, one row per Gaussian; columns as in `ViewInformation.numbers`."""
    return context.episode(_TrainedOfDepth).of(context.mapper)


def units(context: FeatureContext) -> np.ndarray:  # [4]
    """Return the unit of each kind of parameter, computed by `median_units` from H_train of the rendered colours."""
    return median_units(trained(context))


def median_units(known: np.ndarray) -> np.ndarray:  # [N Gaussians, 24 columns] -> [4 kinds]
    """Return the unit of each kind of parameter: mean, log-scale, opacity logit and colour.

    The entries of a kind are averaged for each Gaussian, since the entry along the thin axis of a disk is almost 0. The
    unit is the median of these averages over all Gaussians with a positive one; it is 1 if there are none. ``known``
    is H_train.
    """
    entries = [known[:, columns].mean(axis=1) for columns in _COLUMNS]
    return np.array([np.median(entry[entry > 0]) if (entry > 0).any() else 1.0 for entry in entries])


def diagonal_units(context: FeatureContext, kinds: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:  # [P], [P]
    """Return the columns of `ViewInformation.numbers` with the diagonal of the Fisher information, and their units.

    ``kinds`` selects the parameters from `MEAN`, `LOG_SCALE`, `LOGIT` and `COLOR`, which have P columns together. The
    units are those of `median_units`, for the information of the rendered colours.
    """
    of_kind = context.once(units)
    columns = np.concatenate([_COLUMNS[kind] for kind in kinds])
    return columns, np.concatenate([np.full(len(_COLUMNS[kind]), of_kind[kind]) for kind in kinds])


def informed_views(context: FeatureContext) -> Iterator[ViewInformation]:
    """Yield the Fisher information of the colour image of every candidate about the map, in their order."""
    gaussians, parts = context.mapper.map, MapParts(context.mapper.map)
    for pose in context.world_from_camera:
        unseen = parts.unseen(context.camera, pose)
        yield from view_information(gaussians.parameters, gaussians.count, context.camera, pose, unseen=unseen)


def depth_informed_views(context: FeatureContext) -> Iterator[ViewInformation]:
    """Yield the Fisher information of the depth image of every candidate about the map, in their order."""
    gaussians, parts = context.mapper.map, MapParts(context.mapper.map)
    for pose in context.world_from_camera:
        unseen = parts.unseen(context.camera, pose)
        yield depth_information(gaussians.parameters, gaussians.count, context.camera, pose, unseen=unseen)


def diagonal_gain(
    context: FeatureContext,
    criterion: Callable[[np.ndarray, np.ndarray], np.ndarray],
    kinds: tuple[int, ...] = (MEAN, LOG_SCALE),
) -> np.ndarray:  # [K]
    """Return the sum of ``criterion(h + lambda, d)`` over all parameters, divided by the number of Gaussians.

    ``h`` and ``d`` [S, P] are the diagonals of H_train and H_c divided by the units of the parameters, for the S
    Gaussians that a candidate sees. A criterion must be 0 where ``d`` is 0, since the other Gaussians are left out.
    ``kinds`` selects the parameters.
    """
    columns, unit = diagonal_units(context, kinds)
    prior = np.ascontiguousarray(trained(context)[:, columns] / unit + LAMBDA)
    sums = [criterion(prior[view.indices], view.numbers[:, columns] / unit).sum() for view in informed_views(context)]
    return np.array(sums) / max(1, len(prior))


def observed_share(context: FeatureContext) -> float:  # 0..1
    """Return lambda_o, the fraction of observed voxels in a window of 6 m x 6 m around the newest keyframe.

    The window has all heights of the workspace. Observed voxels are the complement of `VoxelVolume.unobserved`.
    """
    volume, eye = context.volume, context.mapper.keyframes[-1].world_from_camera[:3, 3]
    size = volume.config.voxel_size
    low = np.floor((eye[:2] - 0.5 * WINDOW - volume.origin[:2]) / size).astype(int)
    high = np.ceil((eye[:2] + 0.5 * WINDOW - volume.origin[:2]) / size).astype(int)
    # The outermost voxels are outside the workspace and cannot be observed.
    x, y = (slice(max(1, a), max(1, min(b, n - 1))) for a, b, n in zip(low, high, volume.shape))
    window = volume.unobserved[x, y, 1:-1]
    return 1.0 - float(window.mean()) if window.size else 0.0


def adaptive(context: FeatureContext, coverage: np.ndarray, quality: np.ndarray) -> np.ndarray:  # [K], [K] -> [K]
    """Return G = G_cov + lambda_o G_Q (HGS-Planner) of every candidate, where lambda_o is `observed_share`.

    G_cov is ``coverage`` divided by its maximum over the candidates. The divisor is at least `MIN_COVERAGE`, so that
    little remaining coverage does not outweigh quality. G_Q is the rank of ``quality`` in 0..1 (`share_below`).
    Information spans orders of magnitude: for some criteria the best view has a hundred times the median. Divided by
    the maximum, it would be near 0 for almost all candidates.
    """
    most = max(coverage.max(initial=0.0), MIN_COVERAGE)
    return coverage / most + observed_share(context) * share_below(quality)


def share_below(values: np.ndarray) -> np.ndarray:  # [K] -> [K] in 0..1
    """Return for each value the fraction of all values that are at most as large; 0 where it is not positive."""
    return np.where(values > 0, np.searchsorted(np.sort(values), values, side="right") / max(1, len(values)), 0.0)


def register_both(name: str, unit: str = "per Gaussian of the map") -> Callable[[Compute], Feature]:
    """Return a decorator that registers a score as ``name``, and combined with `hole_area` as ``name_cov``.

    Use it for scores that cannot measure unseen space; `adaptive` combines both. ``unit`` is the unit of the score.
    """

    def register(compute: Compute) -> Feature:
        alone = FEATURES.register(name, unit=unit, low=0.0)(compute)

        @wraps(compute)
        def with_coverage(context: FeatureContext) -> np.ndarray:  # [K]
            return adaptive(context, hole_area(context), context.once(alone))

        with_coverage.__doc__ = f"Return G_cov + lambda_o G_Q of `hole_area` and `{name}`; see `adaptive`."
        FEATURES.register(f"{name}_cov", unit=ADAPTIVE, low=0.0)(with_coverage)
        return alone

    return register
