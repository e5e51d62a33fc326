"""Shared parts of the information features: the prior, the candidates' information, the term for unseen space.

H is the information matrix of the map, J^T J summed over pixels and colours (`activestructure_gym.splatting.fisher`):
H_train of all keyframes, H_c of a candidate, both at the candidates' camera; with ``of_depth`` of the rendered depth.
Metres, logarithms and colours have other units, and one prior for all would mean something else in every map: so every
entry is counted in units of what is known in the median about its kind, and the prior lambda is the same small share of
that unit for all.

Sources: [fisherrf], [popgs]; how large lambda may be: docs/notebook/groundwork.md.
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

LAMBDA = 1e-2  # of the unit
LITTLE = 0.05  # of a view of nothing but unseen space (own choice)
WINDOW = 6.0  # metres, side of HGS-Planner's local window
ADAPTIVE = "share of the best coverage, plus weighted information"  # unit of `adaptive`
MEAN, LOG_SCALE, LOGIT, COLOR = range(4)  # kinds of parameters
_COLUMNS = (DIAGONAL[:3], DIAGONAL[3:], np.array([21]), np.array([22]))  # of `ViewInformation.numbers`, by kind


class _Trained:
    """H_train of an episode: measured when it is asked for, and at most once between two mapping events.

    So it does not depend on how many features ask for it.
    """

    of_depth = False

    def __init__(self, context: FeatureContext) -> None:
        self._information = KeyframeInformation(
            context.mapper.persistent_map, camera=context.camera, of_depth=self.of_depth
        )
        self._event, self._found = -1, np.empty((0, COLUMNS))

    def of(self, mapper: KeyframeMapper) -> np.ndarray:  # [N, 24] float64, to be read only
        if self._event != mapper.events:
            self._event, self._found = mapper.events, self._information.update(mapper.keyframes)
        return self._found


class _TrainedOfDepth(_Trained):
    of_depth = True


def trained(context: FeatureContext) -> np.ndarray:  # [N, 24] float64
    """H_train, columns as in `ViewInformation.numbers`."""
    return context.episode(_Trained).of(context.mapper)


def trained_of_depth(context: FeatureContext) -> np.ndarray:  # [N, 24] float64
    """H_train of the rendered depth."""
    return context.episode(_TrainedOfDepth).of(context.mapper)


def units(context: FeatureContext) -> np.ndarray:  # [4]
    """`median_units` of H_train."""
    return median_units(trained(context))


def units_of_depth(context: FeatureContext) -> np.ndarray:  # [4]
    """`median_units` of the depth's H_train."""
    return median_units(trained_of_depth(context))


def median_units(known: np.ndarray) -> np.ndarray:  # [N, 24] -> [4]
    """Unit per kind of parameter: median information over the Gaussians that have any; 1 without any.

    Of the mean over a Gaussian's entries of that kind: along the thin axis of a disk an entry is next to nothing.
    """
    entries = [known[:, columns].mean(axis=1) for columns in _COLUMNS]
    return np.array([np.median(entry[entry > 0]) if (entry > 0).any() else 1.0 for entry in entries])


def diagonal_units(
    context: FeatureContext, kinds: tuple[int, ...], *, of_depth: bool = False
) -> tuple[np.ndarray, np.ndarray]:  # [P], [P]
    """Columns of the diagonal entries of these kinds, and the unit of each."""
    of_kind = context.once(units_of_depth if of_depth else units)
    columns = np.concatenate([_COLUMNS[kind] for kind in kinds])
    return columns, np.concatenate([np.full(len(_COLUMNS[kind]), of_kind[kind]) for kind in kinds])


def informed_views(context: FeatureContext) -> Iterator[ViewInformation]:
    """The second pass over every candidate, one after the other."""
    gaussians, parts = context.mapper.map, MapParts(context.mapper.map)
    for pose in context.world_from_camera:
        unseen = parts.unseen(context.camera, pose)
        yield from view_information(gaussians.parameters, gaussians.count, context.camera, pose, unseen=unseen)


def depth_informed_views(context: FeatureContext) -> Iterator[ViewInformation]:
    """`informed_views` of the rendered depth."""
    gaussians, parts = context.mapper.map, MapParts(context.mapper.map)
    for pose in context.world_from_camera:
        unseen = parts.unseen(context.camera, pose)
        yield depth_information(gaussians.parameters, gaussians.count, context.camera, pose, unseen=unseen)


def diagonal_gain(
    context: FeatureContext,
    criterion: Callable[[np.ndarray, np.ndarray], np.ndarray],
    kinds: tuple[int, ...] = (MEAN, LOG_SCALE),
    *,
    of_depth: bool = False,
) -> np.ndarray:  # [K]
    """Sum of ``criterion(h + lambda, d)`` over the parameters a candidate informs about, per Gaussian of the map.

    h and d [S, P]: diagonals of H_train and H_c in their units. What a candidate does not see must add nothing.
    """
    columns, unit = diagonal_units(context, kinds, of_depth=of_depth)
    known = trained_of_depth(context) if of_depth else trained(context)
    prior = np.ascontiguousarray(known[:, columns] / unit + LAMBDA)
    views = depth_informed_views(context) if of_depth else informed_views(context)
    sums = [criterion(prior[view.indices], view.numbers[:, columns] / unit).sum() for view in views]
    return np.array(sums) / max(1, len(prior))


def observed_share(context: FeatureContext) -> float:  # 0..1
    """lambda_o: how much of the local window around the agent has been looked into (`VoxelVolume.unobserved`)."""
    volume, eye = context.volume, context.mapper.keyframes[-1].world_from_camera[:3, 3]
    size = volume.config.voxel_size
    low = np.floor((eye[:2] - 0.5 * WINDOW - volume.origin[:2]) / size).astype(int)
    high = np.ceil((eye[:2] + 0.5 * WINDOW - volume.origin[:2]) / size).astype(int)
    # The outermost voxels lie outside of the workspace: nobody can observe them.
    x, y = (slice(max(1, a), max(1, min(b, n - 1))) for a, b, n in zip(low, high, volume.shape))
    window = volume.unobserved[x, y, 1:-1]
    return 1.0 - float(window.mean()) if window.size else 0.0


def adaptive(context: FeatureContext, coverage: np.ndarray, quality: np.ndarray) -> np.ndarray:  # [K], [K] -> [K]
    """G = G_cov + lambda_o G_Q (HGS-Planner): coverage as a share of the best candidate's, quality by its rank.

    The two have no common unit. Information spans many orders of magnitude, and of some criteria the best view has a
    hundred times the median's: as a share of the best nearly all candidates would have none of it, and coverage alone
    would decide. Where even the best candidate's G_cov is below `LITTLE` of a whole view, it counts as a share of that:
    what is left to cover must not hide the other term.
    """
    most = max(coverage.max(initial=0.0), LITTLE)
    return coverage / most + observed_share(context) * share_below(quality)


def share_below(values: np.ndarray) -> np.ndarray:  # [K] -> [K] in 0..1
    """For every value the share of all values that are not above it; 0 where the value is 0."""
    return np.where(values > 0, np.searchsorted(np.sort(values), values, side="right") / max(1, len(values)), 0.0)


def register_both(name: str, unit: str = "per Gaussian of the map") -> Callable[[Compute], Feature]:
    """Decorator of a score that is blind to unseen space: as ``NAME``, and with `hole_area` for it as ``NAME_cov``."""

    def register(compute: Compute) -> Feature:
        alone = FEATURES.register(name, unit=unit, low=0.0)(compute)

        @wraps(compute)
        def with_coverage(context: FeatureContext) -> np.ndarray:  # [K]
            return adaptive(context, hole_area(context), context.once(alone))

        with_coverage.__doc__ = f"G_cov + lambda_o G_Q with `hole_area` and `{name}`; see `adaptive`."
        FEATURES.register(f"{name}_cov", unit=ADAPTIVE, low=0.0)(with_coverage)
        return alone

    return register
