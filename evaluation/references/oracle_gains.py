"""What going to a view would truly show: the surface that the keyframes of the way see first, and what the map gains.

Ground truth, for references and benchmarks; nothing here reaches an observation.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from activestructure_gym.evaluation.protocols import CameraPath, StandardProtocol
from activestructure_gym.evaluation.protocols.sight import seen_by_keyframes
from activestructure_gym.geometry import transform_points
from activestructure_gym.ground_truth import GroundTruth
from activestructure_gym.ground_truth.observable import SIGHT_MARGIN
from activestructure_gym.mapping import GaussianMap
from activestructure_gym.motion import PlannedPath
from activestructure_gym.reconstruction import Reconstruction
from activestructure_gym.scenes import Scene
from activestructure_gym.sensors import RGBDSensor

QUALITY = {"psnr": 1.0, "depth_l1_cm": -1.0, "completion_ratio": 1.0}  # and the sign of what is better

_SAMPLES = 4000  # of the observable surface, spread evenly
_RATIO_SAMPLES = 10_000  # surface points a C.R. is taken on
_BLOCKS = 96  # of a held-out view, at least, whose error stands at one point of the surface


def whole_pool(reconstruction: Reconstruction, most: int | None = None) -> np.ndarray:  # [n, 4, 4] world_from_camera
    """Every view of the pool that can be reached now, no matter how many a table holds; at most ``most``, drawn."""
    pool = copy.copy(reconstruction.pool)
    rows = pool.positions.shape[0] * pool.config.directions if most is None else most
    pool.config = replace(pool.config, max_candidates=max(rows, pool.config.max_revisits + 1))
    nothing = np.zeros((0, 4, 4))
    table = pool.offer(reconstruction.volume, reconstruction.distances, reconstruction.decisions, nothing)
    return table.world_from_camera[:rows]


class TrueSurface:
    """The observable surface of the scene of an episode, and which of it is still to be seen.

    By lines of sight from the keyframes' true poses, as `observed` of the standard protocol, not by the sensor's depth.
    """

    def __init__(self, truth: GroundTruth, samples: int = _SAMPLES) -> None:
        surface = truth.observable_surface
        self._scene = truth.scene
        self.points = surface.points[:: max(1, len(surface.points) // samples)]  # [S, 3]
        self.area = surface.area / max(1, len(self.points))  # m^2 of a point
        self._counted = 0  # keyframes
        self.seen = np.zeros(len(self.points), dtype=bool)

    def follow(self, reconstruction: Reconstruction) -> None:
        """Count the keyframes that the episode has taken since the last call."""
        new = reconstruction.keyframe_indices[self._counted :]
        if new:
            poses = np.stack([reconstruction.trajectory[index] for index in new])
            waiting = np.flatnonzero(~self.seen)
            self.seen[waiting] = shown(reconstruction, self._scene, poses, self.points[waiting])
            self._counted += len(new)

    def new_area(self, reconstruction: Reconstruction, keyframes: np.ndarray) -> float:  # [K, 4, 4] -> m^2
        """The area that these keyframes together would show and none has shown yet."""
        return self.area * int(shown(reconstruction, self._scene, keyframes, self.points[~self.seen]).sum())

    def rates(
        self, reconstruction: Reconstruction, taken: Sequence[PlannedPath | None]
    ) -> np.ndarray:  # [n] m^2 per frame
        """Newly observed area by frame paid, of every way; 0 where there is none."""
        found = [0.0 if w is None else self.new_area(reconstruction, w.keyframes) / max(w.frames, 1) for w in taken]
        return np.array(found, np.float64)


class TrueQuality:
    """What the map of an episode gets right on held-out views of the scene, and what mapping a way changes there.

    The views are the first ones that ``protocol`` measures a finished map by.
    """

    def __init__(self, truth: GroundTruth, protocol: StandardProtocol) -> None:
        self._scene, self._protocol = truth.scene, protocol
        self._truth = protocol.truth(truth)

    def changes(
        self, reconstruction: Reconstruction, taken: Mapping[int, PlannedPath]
    ) -> dict[int, dict[str, float]]:  # of QUALITY, by the same keys
        """Change of the held-out numbers per 100 frames from truly mapping the keyframes of each way, in a copy.

        Rows of the candidate table are the keys, so that a way that ends at a keyframe's own pose is mapped with the
        iterations of a revisit. The noise of the pictures is not the noise the episode would draw; that what is seen
        on the way may block it is not foreseen.
        """
        config = reconstruction.config
        before = self._measured(reconstruction.mapper.map)
        sensor = RGBDSensor(self._scene, config.sensor, np.random.default_rng(reconstruction.decisions))
        found = {}
        try:
            for row, way in taken.items():
                mapper = copy.deepcopy(reconstruction.mapper)
                arrives = np.allclose(way.keyframes[-1], reconstruction.candidates.world_from_camera[row])
                again = arrives and bool(reconstruction.candidates.revisit[row])
                for number, pose in enumerate(way.keyframes, start=1):
                    refine_factor = config.revisit_rounds if again and number == len(way.keyframes) else 1
                    mapper.observe(sensor.capture(pose), iterations=refine_factor * config.mapper.iterations)
                after = self._measured(mapper.map)
                found[row] = {
                    name: 100.0 * (after[name] - before[name]) / way.frames
                    for name in QUALITY
                    if name in after and name in before
                }
        finally:
            sensor.close()
        return found

    def error_points(self, reconstruction: Reconstruction) -> tuple[np.ndarray, np.ndarray]:  # [P, 3], [P]
        """Points of the surface in the held-out views, and how wrong the map is around each in these pictures.

        A view is cut into blocks, each with the true point in its middle and the squared colour error of its pixels,
        divided by that of the view: so they are to first order shares of its PSNR.
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
        taken: Sequence[PlannedPath | None],
        wrong: tuple[np.ndarray, np.ndarray],  # what `error_points` found
    ) -> np.ndarray:  # [n] per frame
        """How much of what is wrong the keyframes of every way would see, per frame paid; 0 where there is none."""
        points, errors = wrong
        found = [
            0.0 if way is None else errors[shown(reconstruction, self._scene, way.keyframes, points)].sum() / way.frames
            for way in taken
        ]
        return np.array(found, np.float64)

    def _measured(self, gaussians: GaussianMap) -> dict[str, float]:
        return self._protocol.checkpoint(gaussians, self._truth, images=True, samples=_RATIO_SAMPLES)


def shown(
    reconstruction: Reconstruction,
    scene: Scene,
    poses: np.ndarray,  # [K, 4, 4] world_from_camera of keyframes
    points: np.ndarray,  # [P, 3] on the surface
) -> np.ndarray:  # [P] bool
    """Which points keyframes of the episode's sensor there would see."""
    sensor = reconstruction.config.sensor
    path = CameraPath(sensor.camera, poses[0], poses, sensor.max_range)
    return seen_by_keyframes(points, path, scene, SIGHT_MARGIN)
