"""Small calls that need the kernels of a first episode, for `compiling.ahead` to make in other processes."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np

from activestructure_gym.compiling.decorator import name_of
from activestructure_gym.compiling.locks import LOCKS


def map_making() -> None:
    """Call the kernels of the rasteriser and the mapper on two frames of a flat wall."""
    from activestructure_gym.mapping.frustum_culling import may_be_seen
    from activestructure_gym.mapping.occlusion_culling import behind_the_measured, depth_tiles

    mapper = map_a_wall()
    score_the_wall(mapper)
    mapper.keyframe_psnr()
    boxes, frame = mapper.map.boxes(), mapper.keyframes[0]  # culling is used on larger maps only
    tiles = depth_tiles(frame.depth, frame.camera, frame.world_from_camera)
    behind_the_measured(boxes[may_be_seen(boxes, frame.camera, frame.world_from_camera)], tiles)


def map_a_wall() -> Any:
    """Call the kernels of a first keyframe; return the mapper, whose map is a flat wall."""
    from activestructure_gym.mapping import Mapper, MapperConfig
    from activestructure_gym.sensors import Frame

    colours = np.random.default_rng(0).integers(0, 256, (36, 64, 3), dtype=np.uint8)
    mapper = Mapper(MapperConfig(), np.random.default_rng(0))
    for depth in (2.0, 1.5):
        mapper.observe(Frame(colours, np.full((36, 64), depth, np.float32), np.eye(4), _camera()))
    return mapper


def score_the_wall(mapper: Any) -> None:
    """Call the rasteriser's kernels that a first decision uses in addition to those of a keyframe."""
    mapper.render_depth_alpha(_camera(), np.eye(4)[None])


def _camera() -> Any:
    from activestructure_gym.geometry import PinholeCamera

    return PinholeCamera.from_size(64, 36)


def sensing() -> None:
    """Call the kernels of the sensor, the volume and the planes."""
    from activestructure_gym.ground_truth import free_space_of
    from activestructure_gym.planes import PlaneGraphConfig, PlaneSceneGraph
    from activestructure_gym.scenes import load_scene
    from activestructure_gym.sensors import RGBDSensor, SensorConfig
    from activestructure_gym.volume import VolumeConfig, VoxelVolume

    scene = load_scene("box")
    sensor = RGBDSensor(scene, SensorConfig(width=64, height=36), np.random.default_rng(0))
    volume, planes = VoxelVolume(scene.bounds, VolumeConfig()), PlaneSceneGraph(PlaneGraphConfig())
    for pose in free_space_of(scene).start_poses[:3]:
        frame = sensor.capture(pose)
        volume.integrate(frame)
        planes.update(frame)


def motion() -> None:
    """Call the motion kernels in a volume with hand-made free space."""
    from activestructure_gym.motion import first_blocked, path_lengths
    from activestructure_gym.volume import VolumeConfig, VoxelVolume

    volume = VoxelVolume(np.array([[0.0, 0.0, 0.0], [3.0, 3.0, 2.0]]), VolumeConfig())
    path = plan_around_a_corner(volume)
    path_lengths(volume, path[0], min_clearance=0.2).at(path)
    poses = np.tile(np.eye(4), (len(path), 1, 1))
    poses[:, :3, 3] = path
    first_blocked(volume, poses[1:], 0.2, start=poses[0])


def plan_around_a_corner(volume: Any) -> np.ndarray:  # [P, 3]
    """Call the RRT kernels by planning around a corner; the empty box room never needs RRT."""
    from activestructure_gym.motion import plan_path

    corner = [[0.6, y, 1.0] for y in np.arange(0.6, 2.5, 0.2)] + [[x, 2.4, 1.0] for x in np.arange(0.8, 2.5, 0.2)]
    for place in np.array(corner):
        volume.mark_free_sphere(place, 0.5)
    path = plan_path(volume, np.array(corner[0]), np.array(corner[-1]), min_clearance=0.2, rng=np.random.default_rng(0))
    assert path is not None
    return path


def views() -> None:
    """Call the kernels of features and visibility that read more than rendered maps."""
    from activestructure_gym.features.hole_area import hidden_distances
    from activestructure_gym.geometry import PinholeCamera
    from activestructure_gym.views.visibility import visible_cosines
    from activestructure_gym.volume import VolumeConfig, VoxelVolume

    camera = PinholeCamera.from_size(16, 9)
    volume = VoxelVolume(np.array([[0.0, 0.0, 0.0], [3.0, 3.0, 2.0]]), VolumeConfig())
    pose, points = np.eye(4)[None], np.ones((1, 1, 3))
    hidden_distances(volume, camera, pose, 2.0, np.ones((1, 9, 16), bool), stride=1)
    visible_cosines(points, points[0], camera, pose, volume)


Calls = list[tuple[Any, tuple[Any, ...]]]  # kernels, each with the arguments of one call


@lru_cache(1)
def calls_of_the_rasteriser() -> tuple[Calls, Calls]:
    """Return the rasteriser's kernel calls of a first keyframe, then those added by a first decision; run none."""
    from activestructure_gym.compiling.thread_team import TEAM

    calls = dict[Any, tuple[Any, ...]]()

    def note(kernel: Any, arguments: tuple[Any, ...], threads: int) -> None:
        calls.setdefault(kernel, arguments)
        arguments[0][:] = 1 << 10  # tickets: all work units of this tiny map count as done

    run, TEAM.run = TEAM.run, note  # type: ignore[method-assign]
    try:
        mapper = map_a_wall()
        of_keyframe = len(calls)
        score_the_wall(mapper)
    finally:
        TEAM.run = run  # type: ignore[method-assign]
    return list(calls.items())[:of_keyframe], list(calls.items())[of_keyframe:]


def rasteriser() -> None:
    """Compile the kernels of a first keyframe, last one first.

    The main process compiles them from the first one on.
    """
    for kernel, arguments in reversed(calls_of_the_rasteriser()[0]):
        _compile(kernel, arguments)


def score() -> None:
    """Compile the kernels that only a first decision calls."""
    for kernel, arguments in calls_of_the_rasteriser()[1]:
        _compile(kernel, arguments)


def _compile(kernel: Any, arguments: tuple[Any, ...]) -> None:
    """Compile a kernel unless another process is compiling it."""
    from numba import typeof

    if not LOCKS.is_held(name_of(kernel)):
        kernel.compile(tuple(typeof(argument) for argument in arguments))
