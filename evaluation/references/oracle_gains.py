"""Compute the true gain of moving to a view: newly observed surface, and the change of the map's quality.

Both gains use the ground truth. They are for references (oracles) and benchmarks; no observation contains them.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from activestructure_gym.evaluation.protocols import CameraPath, StandardProtocol
from activestructure_gym.evaluation.protocols.visibility import seen_by_keyframes, seen_on_paths
from activestructure_gym.geometry import transform_points
from activestructure_gym.ground_truth import GroundTruth
from activestructure_gym.ground_truth.observable import SIGHT_MARGIN
from activestructure_gym.mapping import GaussianMap
from activestructure_gym.motion import PlannedPath
from activestructure_gym.reconstruction import Reconstruction
from activestructure_gym.scenes import Scene
from activestructure_gym.sensors import RGBDSensor

QUALITY = {"psnr": 1.0, "depth_l1_cm": -1.0, "completion_ratio": 1.0}  # +1 if higher is better, -1 if lower

_SAMPLES = 4000  # approximate number of samples of the observable surface
_RATIO_SAMPLES = 10_000  # approximate number of surface samples for a completion ratio
_BLOCKS = 96  # approximate number of blocks of a held-out view; a block's error is assigned to one surface point


def whole_pool(reconstruction: Reconstruction, most: int | None = None) -> np.ndarray:  # [n, 4, 4] world_from_camera
    """Return all reachable views of the candidate pool, without the row limit of the candidate table.

    If ``most`` is given, at most that many views are drawn at random.
    """
    pool = copy.copy(reconstruction.pool)
    rows = pool.positions.shape[0] * pool.config.directions if most is None else most
    pool.config = replace(pool.config, max_candidates=max(rows, pool.config.max_revisits + 1))
    nothing = np.zeros((0, 4, 4))
    table = pool.offer(reconstruction.volume, reconstruction.distances, reconstruction.decisions, nothing)
    return table.world_from_camera[:rows]


class TrueSurface:
    """Track which part of the observable surface was visible in the keyframes of an episode.

    Visibility is tested by lines of sight from the true poses of the keyframes, as for ``observed`` in the standard
    protocol. The depth images are not used.
    """

    def __init__(self, truth: GroundTruth) -> None:
        surface = truth.observable_surface
        self._scene = truth.scene
        self.points = surface.points[:: max(1, len(surface.points) // _SAMPLES)]  # [S, 3]
        self.area = surface.area / max(1, len(self.points))  # m^2 per point
        self._counted = 0  # keyframes processed so far
        self.seen = np.zeros(len(self.points), dtype=bool)  # [S]

    def follow(self, reconstruction: Reconstruction) -> None:
        """Mark as seen the points that are visible in the keyframes since the last call of this method."""
        new = reconstruction.keyframe_indices[self._counted :]
        if new:
            poses = np.stack([reconstruction.trajectory[index] for index in new])
            waiting = np.flatnonzero(~self.seen)
            self.seen[waiting] = visible_points(reconstruction, self._scene, poses, self.points[waiting])
            self._counted += len(new)

    def new_areas(self, reconstruction: Reconstruction, paths: Sequence[PlannedPath | None]) -> np.ndarray:  # [n] m^2
        """Return for each path the newly observed area; 0 for a candidate without a path (None)."""
        return self.area * visible_sums(reconstruction, self._scene, paths, self.points[~self.seen])

    def rates(
        self, reconstruction: Reconstruction, paths: Sequence[PlannedPath | None]
    ) -> np.ndarray:  # [n] m^2 per frame
        """Return for each path the newly observed area per frame; 0 for a candidate without a path (None)."""
        return self.new_areas(reconstruction, paths) / path_frames(paths)


class TrueQuality:
    """Measure the quality of a map on held-out views, and its change if the keyframes of a path were mapped.

    ``protocol`` draws the held-out views and computes the scores.
    """

    def __init__(self, truth: GroundTruth, protocol: StandardProtocol) -> None:
        self._scene, self._protocol = truth.scene, protocol
        self._truth = protocol.truth(truth)

    def changes(
        self, reconstruction: Reconstruction, paths: Mapping[int, PlannedPath]
    ) -> dict[int, dict[str, float]]:  # changes of the scores in `QUALITY` by row
        """Map the keyframes of each path in a copy of the map; return the changes of the scores per 100 frames.

        ``paths`` and the result have the rows of the candidate table as keys. At the end of a path that revisits a
        keyframe, the mapper makes ``revisit_rounds`` times the iterations, as in the episode. The sensor noise differs
        from the noise that the episode would draw. Obstacles that would be discovered on the path are ignored.
        """
        config = reconstruction.config
        before = self._measured(reconstruction.mapper.map)
        sensor = RGBDSensor(self._scene, config.sensor, np.random.default_rng(reconstruction.decisions))
        found = {}
        try:
            for row, path in paths.items():
                mapper = copy.deepcopy(reconstruction.mapper)
                arrives = np.allclose(path.keyframes[-1], reconstruction.candidates.world_from_camera[row])
                revisits = arrives and bool(reconstruction.candidates.revisit[row])
                for number, pose in enumerate(path.keyframes, start=1):
                    refine_factor = config.revisit_rounds if revisits and number == len(path.keyframes) else 1
                    mapper.observe(sensor.capture(pose), iterations=refine_factor * config.mapper.iterations)
                after = self._measured(mapper.map)
                found[row] = {
                    name: 100.0 * (after[name] - before[name]) / path.frames
                    for name in QUALITY
                    if name in after and name in before
                }
        finally:
            sensor.close()
        return found

    def error_points(self, reconstruction: Reconstruction) -> tuple[np.ndarray, np.ndarray]:  # [P, 3] metres, [P]
        """Return true surface points in the held-out views, and the map's relative colour error around each point.

        Every view is divided into about 96 blocks of pixels. Each block gives one point: the surface at its centre. Its
        error is the sum of the squared colour errors in the block, divided by the sum over the view. To first order
        this is the share of the block in the view's PSNR.
        """
        views = self._truth.views
        size = max(1, int(np.sqrt(views.camera.width * views.camera.height / _BLOCKS)))
        across, down = views.camera.width // size, views.camera.height // size
        points, errors = [], []
        for index, (pose, depth) in enumerate(zip(views.world_from_camera, views.depth)):
            true = views.rgb[index].astype(np.float32) / np.float32(255.0)
            picture = self._protocol.picture(reconstruction.mapper.map, self._truth, index)
            squared = np.square(picture - true).mean(axis=-1)[: down * size, : across * size]
            blocks = squared.reshape(down, size, across, size).sum(axis=(1, 3))
            middle = (slice(size // 2, down * size, size), slice(size // 2, across * size, size))
            known = depth[middle] > 0
            places = views.camera.backproject(depth)[middle]
            points.append(transform_points(pose, places[known]))
            errors.append(blocks[known] / max(float(squared.sum()), 1e-12))
        return np.concatenate(points), np.concatenate(errors)

    def visible_errors(
        self,
        reconstruction: Reconstruction,
        paths: Sequence[PlannedPath | None],
        wrong: tuple[np.ndarray, np.ndarray],  # the result of `error_points`
    ) -> np.ndarray:  # [n] per frame
        """Return for each path the sum of the errors visible from its keyframes, divided by the frames of the path.

        The value is 0 for a candidate without a path (None).
        """
        points, errors = wrong
        return visible_sums(reconstruction, self._scene, paths, points, errors) / path_frames(paths)

    def _measured(self, gaussians: GaussianMap) -> dict[str, float]:
        return self._protocol.checkpoint(gaussians, self._truth, images=True, samples=_RATIO_SAMPLES)


def path_frames(paths: Sequence[PlannedPath | None]) -> np.ndarray:  # [n] at least 1
    """Return the frames of each path; 1 for a candidate without a path (None)."""
    return np.array([1 if path is None else max(path.frames, 1) for path in paths])


def visible_sums(
    reconstruction: Reconstruction,
    scene: Scene,
    paths: Sequence[PlannedPath | None],
    points: np.ndarray,  # [P, 3] on the surface
    weights: np.ndarray | float = 1.0,  # [P]
) -> np.ndarray:  # [n]
    """Return for each path the sum of the weights of the points that the sensor of the episode sees on it.

    The value is 0 for a candidate without a path (None).
    """
    sensor = reconstruction.config.sensor
    keyframes = [np.zeros((0, 4, 4)) if path is None else path.keyframes for path in paths]
    seen = seen_on_paths(points, keyframes, sensor.camera, sensor.max_range, scene, SIGHT_MARGIN)
    return np.where(seen, weights, 0.0).sum(axis=1)


def visible_points(
    reconstruction: Reconstruction,
    scene: Scene,
    poses: np.ndarray,  # [K, 4, 4] world_from_camera of keyframes
    points: np.ndarray,  # [P, 3] on the surface
) -> np.ndarray:  # [P] bool
    """Return which points are visible to the sensor of the episode in at least one of the poses."""
    sensor = reconstruction.config.sensor
    path = CameraPath(sensor.camera, poses[0], poses, sensor.max_range)
    return seen_by_keyframes(points, path, scene, SIGHT_MARGIN)
