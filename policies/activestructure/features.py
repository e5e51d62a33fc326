"""IG_def of Eq. 13: area of known deficiencies of planes that a view would mend."""

from __future__ import annotations

from typing import Any

import numpy as np

from activestructure_gym.features.context import FeatureContext
from activestructure_gym.features.hole_area import REACH, largest_area
from activestructure_gym.features.registry import FEATURES
from activestructure_gym.views.visibility import cosines_in_sight


@FEATURES.register("deficiency", unit="as hole_area", low=0.0, high=1.0)
def deficiency(context: FeatureContext) -> np.ndarray:  # [K] in 0..1
    """Area of the deficiency centres C_def that a view would mend, in the unit of `hole_area`.

    A centre stands for a patch of known area. It counts where it is in sight and near enough for the surface there to
    become reconstructed: a hole up to the reach of `hole_area`, a patch that the map covers too coarsely from where its
    Gaussians would be replaced by finer ones. A hole in which some image showed something else, such as a window, does
    not count: no view will ever fill it.

    A centre gets used to being looked at: a keyframe that had it in sight on the same terms, and after which it is
    still there, has spent pixels on it in vain. What counts is the share that the view's own pixels have in all of
    them (`pull`), so that looking again is worth half, a third, a quarter, and a look from much nearer nearly all.
    """
    holes, camera, poses = context.planes.deficiencies, context.camera, context.world_from_camera
    if not len(holes) or not len(poses):
        return np.zeros(len(poses))
    taken = np.array([frame.world_from_camera for frame in context.mapper.keyframes]).reshape(-1, 4, 4)
    views = np.concatenate([poses, taken])
    cosines, _ = cosines_in_sight(
        holes.centres[:, None], holes.normals, camera, views, context.volume,
        farthest=np.minimum(refining_distance(context, holes.sizes), REACH),
    )  # fmt: skip
    looks = pixels_per_area(cosines[:, :, 0], views, holes.centres)
    area = pull(looks[: len(poses)], looks[len(poses) :].sum(axis=0)) @ np.where(holes.explained, 0.0, holes.areas)
    return area / largest_area(camera)


def pixels_per_area(
    cosines: np.ndarray,  # [V, D] between normal and line of sight, 0 where out of sight
    views: np.ndarray,  # [V, 4, 4] world_from_camera
    centres: np.ndarray,  # [D, 3]
) -> np.ndarray:  # [V, D] 1 / m^2, times the squared focal length pixels per square metre
    """How finely each view samples each patch of surface: cos / distance^2."""
    squared = np.zeros(cosines.shape)
    seen = np.nonzero(cosines)
    squared[seen] = np.square(views[seen[0], :3, 3] - centres[seen[1]]).sum(axis=-1)
    return np.divide(cosines, squared, out=np.zeros(cosines.shape), where=squared > 0)


def pull(
    looks: np.ndarray,  # [K, D] >= 0, of the candidates
    spent: np.ndarray,  # [D] >= 0, of the keyframes that were taken
) -> np.ndarray:  # [K, D] in 0..1
    """Share of a candidate's look in it and all that was spent before; 0 without a look, 1 where nothing was spent."""
    together = looks + spent
    return np.divide(looks, together, out=np.zeros(together.shape), where=looks > 0)


def refining_distance(context: FeatureContext, sizes: np.ndarray) -> np.ndarray:  # [D] metres
    """Largest distance at which a frame replaces Gaussians of these sizes (`MapperConfig.coarse_ratio`).

    Where there is texture; plain surface is as fine as it gets.
    """
    config: Any = context.mapper.config  # of another system, without such a ratio
    stored = context.mapper.keyframes[-1].camera
    if getattr(config, "coarse_ratio", None) is None or config.seed_spacing is None:
        return np.where(np.isinf(sizes), np.inf, 0.0)
    limit = config.coarse_ratio * config.seed_footprint * config.seed_pixels  # pixels
    focal = 0.5 * (stored.fx + stored.fy) * config.keyframe_reduction  # a frame is seeded before it is reduced
    return np.asarray(sizes * focal / limit)


@FEATURES.register("structure", unit="sum of deficits, 0 to 1 each", low=0.0)
def structure(context: FeatureContext) -> np.ndarray:  # [K]
    """Sum of the information deficits gamma_i (Eq. 10) of the planes the view sees: Eq. 13 with all alpha_i = 1.

    `activestructure_gym.policies.activestructure` needs the sum per type and phase, and takes visibility and deficits
    from the observation instead.
    """
    return context.visible @ context.planes.state.deficit
