"""Make the parts of an episode from its configuration: mapper, volume, planes, candidate pool, tracked poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from activestructure_gym.config import ReconstructionConfig, replaced
from activestructure_gym.mapping import KeyframeMapper, track_pose
from activestructure_gym.mapping.adapted import keyframe_mapper
from activestructure_gym.mapping.keyframes_only import KeyframesOnly
from activestructure_gym.motion import levelled
from activestructure_gym.planes import PlaneSceneGraph, depth_noise_scale
from activestructure_gym.sensors import Frame, SensorConfig
from activestructure_gym.sources import Source, only_views_of_pool
from activestructure_gym.views import CandidatePool, GivenViews, without_overlap
from activestructure_gym.volume import VoxelVolume
from activestructure_gym.worlds import Views, checked_views


def make_mapper(config: ReconstructionConfig, bounds: np.ndarray, rng: np.random.Generator) -> KeyframeMapper:
    """Return the configured mapper for ``bounds`` [2, 3]; it assumes at least the sensor's own noise scale."""
    if not config.mapper.enabled:
        return KeyframesOnly(config.mapper, rng)
    made = config.mapper.make(rng, bounds, depth_noise_scale=_multiplier(config.sensor))
    return keyframe_mapper(made, config.mapper)


def make_volume(config: ReconstructionConfig, bounds: np.ndarray) -> VoxelVolume:
    """Return the volume of ``bounds`` [2, 3]. Its margins are tuned for Kinect noise; a noisier sensor widens them."""
    growth = config.volume.margin_growth * max(1.0, _multiplier(config.sensor))
    return VoxelVolume(bounds, replaced(config.volume, {"margin_growth": growth}))


def make_planes(config: ReconstructionConfig) -> PlaneSceneGraph:
    """Return the Plane Scene Graph; its detector assumes at least the sensor's own noise scale."""
    own = depth_noise_scale(config.sensor.depth_noise, config.sensor.noise_multiplier)
    scale = max(config.planes.detection.depth_noise_scale, own)
    return PlaneSceneGraph(replaced(config.planes, {"detection": {"depth_noise_scale": scale}}))


def make_pool(config: ReconstructionConfig, bounds: np.ndarray, start: np.ndarray, seed: int) -> CandidatePool:
    """Return the pool of a lattice in ``bounds`` [2, 3] around the ``start`` position [3]; ``seed`` draws subsets."""
    return CandidatePool(start, bounds, config.views, seed, clearance_m=config.motion.candidate_clearance)


def make_given_pool(
    config: ReconstructionConfig,
    views: Views,
    volume: VoxelVolume,
    bounds: np.ndarray,  # [2, 3] metres
    seed: int,
    sources: dict[str, Source],
) -> GivenViews:
    """Return the pool of a world that can capture given views only, and mark the space around them as free.

    Raises `InputError` if a configured source proposes other poses, or if no view is inside the bounds.
    """
    only_views_of_pool(sources)
    views = checked_views(views, bounds)
    level = np.stack([levelled(pose) for pose in views.world_from_camera])
    radii = np.minimum(config.motion.start_free_radius, views.free_radius)
    for index in without_overlap(level[:, :3, 3], radii, slack=0.5 * volume.voxel_size):
        volume.mark_free_sphere(level[index, :3, 3], float(radii[index]))
    return GivenViews(level, config.views, seed)


def tracks(config: ReconstructionConfig) -> bool:
    """Return whether the reported poses are tracked against the keyframes: only if they are noisy."""
    sensor = config.sensor
    return config.mapper.tracking.iterations > 0 and (sensor.pose_noise_m > 0 or sensor.pose_noise_deg > 0)


def tracked(frame: Frame, keyframes: Sequence[Frame], start: np.ndarray, config: ReconstructionConfig) -> Frame:
    """Return the frame with its pose tracked against the ``keyframes``; the first frame gets the ``start`` pose [4, 4].

    The start pose defines the world frame, as in SLAM (simultaneous localisation and mapping); a noisy start would
    tilt that frame.
    """
    if not keyframes:
        return replace(frame, world_from_camera=start.copy())
    sensor = config.sensor
    found = track_pose(
        frame,
        keyframes,
        config.mapper.tracking,
        sigma_m=sensor.pose_noise_m,
        sigma_deg=sensor.pose_noise_deg,
    )
    return replace(frame, world_from_camera=found.world_from_camera)


def _multiplier(sensor: SensorConfig) -> float:
    """Return the factor on the depth errors of the noise model; 0 for a sensor without noise."""
    return sensor.noise_multiplier if sensor.depth_noise != "none" else 0.0
