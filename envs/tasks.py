"""The registered tasks: the same environment with another default scene."""

from __future__ import annotations

from typing import Any

import numpy as np

from activestructure_gym.envs.reconstruction_env import ReconstructionEnv
from activestructure_gym.errors import InputError, shown
from activestructure_gym.scenes.library import with_options


def _page(task: str) -> str:
    """The environment's manual with the task's own sentence on top."""
    head = "## Description\n"
    return (ReconstructionEnv.__doc__ or "").replace(head, f"{head}    {task}\n\n", 1)


class RoomEnv(ReconstructionEnv):
    __doc__ = _page("**Room-v0**: one furnished procedural room; `scene_seed` picks the layout.")

    def __init__(self, *, scene: Any = "room", scene_seed: int | None = None, **options: Any) -> None:
        super().__init__(_with_numbers(scene, scene_seed=scene_seed), **options)


class ApartmentEnv(ReconstructionEnv):
    __doc__ = _page("**Apartment-v0**: a furnished procedural apartment of `rooms` (1 to 7); `scene_seed` picks it.")

    def __init__(
        self, *, scene: Any = "apartment", rooms: int | None = None, scene_seed: int | None = None, **options: Any
    ) -> None:
        super().__init__(_with_numbers(scene, rooms=rooms, scene_seed=scene_seed), **options)


class MeshEnv(ReconstructionEnv):
    __doc__ = _page('**Mesh-v0**: any mesh file, `scene="file.glb"` or `scene="file.obj?units=mm&up=y"`.')

    def __init__(self, *, scene: Any = None, **options: Any) -> None:
        super().__init__(_with_loader(scene, "mesh", "Mesh-v0", "file.glb"), **options)


class ReplicaEnv(ReconstructionEnv):
    __doc__ = _page('**Replica-v0**: a scene of the Replica dataset, `scene="replica_v1/room_0"`.')

    def __init__(self, *, scene: Any = None, **options: Any) -> None:
        super().__init__(_with_loader(scene, "replica", "Replica-v0", "replica_v1/room_0"), **options)


class Matterport3DEnv(ReconstructionEnv):
    __doc__ = _page('**Matterport3D-v0**: a scene of Matterport3D, `scene="mp3d/GdvgFV5R1Z5"`.')

    def __init__(self, *, scene: Any = None, **options: Any) -> None:
        super().__init__(_with_loader(scene, "matterport3d", "Matterport3D-v0", "mp3d/GdvgFV5R1Z5"), **options)


def _with_loader(scene: Any, loader: str, task: str, example: str) -> Any:
    """Prefix paths with the loader that reads them; Scene objects and prefixed specs pass."""
    if scene is None:
        raise InputError(
            f"{task} needs a scene, for example "
            f'gymnasium.make("activestructure_gym:ActiveStructure/{task}", scene="{example}")'
        )
    if isinstance(scene, str):
        return scene if scene.startswith(f"{loader}:") else f"{loader}:{scene}"
    if isinstance(scene, list | tuple):
        return [_with_loader(one, loader, task, example) for one in scene]
    return scene


def _with_numbers(scene: Any, **numbers: int | None) -> Any:
    """The scene with the options that were given: ``scene_seed`` is its ``seed``. Refuses what the scene cannot use."""
    given = {name: number for name, number in numbers.items() if number is not None}
    for name, number in given.items():
        if isinstance(number, bool) or not isinstance(number, int | np.integer) or not 0 <= number < 2**63:
            raise InputError(f"{name} must be a whole number from 0 to 2^63 - 1, got {shown(number)}")
    options = {name.removeprefix("scene_"): int(number) for name, number in given.items()}
    return _with_options(scene, options) if options else scene


def _with_options(scene: Any, options: dict[str, int]) -> Any:
    if isinstance(scene, list | tuple):
        return [_with_options(one, options) for one in scene]
    return with_options(scene, options)
