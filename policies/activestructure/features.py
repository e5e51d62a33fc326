"""Compute IG_def of Eq. 13, the area of deficient patches of planes that a view would repair, and plane deficits."""

from __future__ import annotations

from typing import Any

import numpy as np

from activestructure_gym.features.context import FeatureContext
from activestructure_gym.features.hole_area import REACH, largest_area
from activestructure_gym.features.registry import FEATURES
from activestructure_gym.views.visibility import visible_cosines


@FEATURES.register("deficiency", unit="as hole_area", low=0.0, high=1.0)
def deficiency(context: FeatureContext) -> np.ndarray:  # [K] in 0..1
    """Compute IG_def: the area of the deficiency centres C_def that a view would repair, in the unit of `hole_area`.

    A centre represents a patch of known area: a hole in a plane, or a patch that the map covers too coarsely. It counts
    if it is visible and near enough. The limit is 4 m for a hole. For a coarse patch it is the distance from which a
    frame would replace its Gaussians by finer ones. A hole does not count if an image showed something else in it, such
    as a window, since no view can fill it.

    Repeated views of a centre count less. The area is multiplied by the share of this view in the pixels that all views
    of the centre have: this view and the earlier keyframes (`pixel_share`). A repeated view from the same distance thus
    counts one half, then one third, then one quarter. A view from much nearer counts almost fully.
    """
    holes, camera, poses = context.planes.deficiencies, context.camera, context.world_from_camera
    if not len(holes) or not len(poses):
        return np.zeros(len(poses))
    taken = np.array([frame.world_from_camera for frame in context.mapper.keyframes]).reshape(-1, 4, 4)
    views = np.concatenate([poses, taken])
    cosines, _ = visible_cosines(
        holes.centres[:, None], holes.normals, camera, views, context.volume,
        farthest=np.minimum(refining_distance(context, holes.sizes), REACH),
    )  # fmt: skip
    pixels = pixels_per_area(cosines[:, :, 0], views, holes.centres)
    share = pixel_share(pixels[: len(poses)], pixels[len(poses) :].sum(axis=0))
    area = share @ np.where(holes.explained, 0.0, holes.areas)
    return area / largest_area(camera)


def pixels_per_area(
    cosines: np.ndarray,  # [V, D] cosine between normal and line of sight, 0 if not visible
    views: np.ndarray,  # [V, 4, 4] world_from_camera
    centres: np.ndarray,  # [D, 3]
) -> np.ndarray:  # [V, D] 1 / m^2; times the squared focal length, it is pixels per square metre
    """Return the sampling density cos(angle) / distance^2 of each of D surface patches in each of V views."""
    squared = np.zeros(cosines.shape)
    seen = np.nonzero(cosines)
    squared[seen] = np.square(views[seen[0], :3, 3] - centres[seen[1]]).sum(axis=-1)
    return np.divide(cosines, squared, out=np.zeros(cosines.shape), where=squared > 0)


def pixel_share(
    pixels: np.ndarray,  # [K, D] >= 0, of the candidates
    spent: np.ndarray,  # [D] >= 0, of all keyframes
) -> np.ndarray:  # [K, D] in 0..1
    """Return pixels / (pixels + spent), a candidate's share of the pixels in which all views see a surface patch.

    The share is 0 if the candidate does not see the patch, and 1 if only the candidate sees it. Both arguments have the
    unit of `pixels_per_area`.
    """
    total = pixels + spent
    return np.divide(pixels, total, out=np.zeros(total.shape), where=pixels > 0)


def refining_distance(context: FeatureContext, sizes: np.ndarray) -> np.ndarray:  # [D] metres
    """Return the largest distance from which a frame replaces Gaussians of ``sizes`` [D] metres by finer ones.

    The mapper replaces Gaussians whose size in the image exceeds a limit (`MapperConfig.coarse_ratio`). This holds for
    surface with texture; Gaussians of plain surface are not replaced. For mappers that never replace Gaussians, the
    distance is infinite for holes and 0 for other patches.
    """
    config: Any = context.mapper.config  # the configurations of other mappers have no coarse_ratio
    stored = context.mapper.keyframes[-1].camera
    if getattr(config, "coarse_ratio", None) is None or config.seed_spacing is None:
        return np.where(np.isinf(sizes), np.inf, 0.0)
    limit = config.coarse_ratio * config.seed_footprint * config.seed_pixels  # pixels
    focal = 0.5 * (stored.fx + stored.fy) * config.keyframe_reduction  # pixels, of frames before their reduction
    return np.asarray(sizes * focal / limit)


@FEATURES.register("structure", unit="sum of deficits, 0 to 1 each", low=0.0)
def structure(context: FeatureContext) -> np.ndarray:  # [K]
    """Compute the sum of the information deficits gamma_i (Eq. 10) of the visible planes: Eq. 13 with alpha_i = 1.

    The policy ActiveStructure does not use this feature. Its sum has weights by type of plane and by phase, and is
    computed from the visibility and the deficits in the observation.
    """
    return context.visible @ context.planes.state.deficit
