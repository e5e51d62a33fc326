"""Define the registered tasks: one environment class for each kind of scene."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar, Unpack

import numpy as np

from activestructure_gym.envs.inputs import Scenes
from activestructure_gym.envs.reconstruction_env import EnvOptions, ReconstructionEnv
from activestructure_gym.errors import InputError, short_repr, unknown_keyword
from activestructure_gym.ground_truth import Layout
from activestructure_gym.ground_truth.layouts import MAX_LAYOUTS, layout_specs
from activestructure_gym.scenes.library import with_options
from activestructure_gym.scenes.procedural.layout import MAX_ROOMS
from activestructure_gym.worlds import World, is_world
from activestructure_gym.worlds.registry import PREFIX

E = TypeVar("E", bound=type[ReconstructionEnv])

_LAYOUTS = "int | none | draw the layout of every episode from the first N training layouts, which have no light"


def task(sentence: str, **arguments: str) -> Callable[[E], E]:
    """Return a class decorator that writes the docstring and the signature of a task.

    The docstring is that of `ReconstructionEnv` with ``sentence`` and with the task's own ``arguments`` added. Each
    value of ``arguments`` is a table row ``type | default | meaning``. The signature lists all keywords in place of
    ``**options``, so that ``help()`` and editors show them.
    """

    def make(kind: E) -> E:
        head, first = "## Description\n", "| `preset` |"
        text = inspect.cleandoc(ReconstructionEnv.__doc__ or "")  # Python 3.13 stores docstrings without their indent
        page = text.replace(head, f"{head}{sentence}\n\n", 1)
        rows = "".join(f"| `{name}` | {row} |\n" for name, row in arguments.items())
        kind.__doc__ = page.replace(first, rows + first, 1)
        own = [p for p in inspect.signature(kind).parameters.values() if p.kind is p.KEYWORD_ONLY]
        shared = [p for name, p in inspect.signature(ReconstructionEnv).parameters.items() if name != "scene"]
        kind.__signature__ = inspect.Signature([*own, *shared])  # type: ignore[attr-defined]
        return kind

    return make


@task(
    "**Room-v0**: one furnished procedural room; `scene_seed` picks the layout.",
    scene_seed="int | 0 | seed of the layout, at least 0",
    layouts=_LAYOUTS,
)
class RoomEnv(ReconstructionEnv):
    """Explore one furnished procedural room."""

    def __init__(
        self,
        *,
        scene: Scenes = "room",
        scene_seed: int | None = None,
        layouts: int | None = None,
        **options: Unpack[EnvOptions],
    ) -> None:
        _check_names(RoomEnv, options, "scene", "scene_seed", "layouts")
        if layouts is None:
            scene = _with_numbers(scene, scene_seed=scene_seed)
        else:
            _check_alone(scene=scene != "room", scene_seed=scene_seed is not None)
            scene = _layouts(layouts, (1,))
        super().__init__(scene, **options)


@task(
    "**Apartment-v0**: a furnished procedural apartment of `rooms` (1 to 7) rooms; `scene_seed` picks the layout.",
    rooms="int | 3 | number of rooms, 1 to 7; with `layouts` also several numbers, taken in turn",
    scene_seed="int | 0 | seed of the layout, at least 0",
    layouts=_LAYOUTS,
)
class ApartmentEnv(ReconstructionEnv):
    """Explore a furnished procedural apartment."""

    def __init__(
        self,
        *,
        scene: Scenes = "apartment",
        rooms: int | Sequence[int] | None = None,
        scene_seed: int | None = None,
        layouts: int | None = None,
        **options: Unpack[EnvOptions],
    ) -> None:
        _check_names(ApartmentEnv, options, "scene", "rooms", "scene_seed", "layouts")
        if layouts is None:
            scene = _with_numbers(scene, rooms=rooms, scene_seed=scene_seed)
        else:
            _check_alone(scene=scene != "apartment", scene_seed=scene_seed is not None)
            scene = _layouts(layouts, 3 if rooms is None else rooms)
        super().__init__(scene, **options)


@task('**Mesh-v0**: any mesh file, `scene="file.glb"` or `scene="file.obj?units=mm&up=y"`.')
class MeshEnv(ReconstructionEnv):
    """Explore a mesh file."""

    def __init__(self, *, scene: Scenes | None = None, **options: Unpack[EnvOptions]) -> None:
        _check_names(MeshEnv, options, "scene")
        super().__init__(_with_loader(scene, "mesh", "Mesh-v0", "file.glb"), **options)


@task('**Replica-v0**: a scene of the Replica dataset, `scene="replica_v1/room_0"`.')
class ReplicaEnv(ReconstructionEnv):
    """Explore a scene of the Replica dataset."""

    def __init__(self, *, scene: Scenes | None = None, **options: Unpack[EnvOptions]) -> None:
        _check_names(ReplicaEnv, options, "scene")
        super().__init__(_with_loader(scene, "replica", "Replica-v0", "replica_v1/room_0"), **options)


@task('**Matterport3D-v0**: a scene of Matterport3D, `scene="mp3d/GdvgFV5R1Z5"`.')
class Matterport3DEnv(ReconstructionEnv):
    """Explore a scene of the Matterport3D dataset."""

    def __init__(self, *, scene: Scenes | None = None, **options: Unpack[EnvOptions]) -> None:
        _check_names(Matterport3DEnv, options, "scene")
        super().__init__(_with_loader(scene, "matterport3d", "Matterport3D-v0", "mp3d/GdvgFV5R1Z5"), **options)


@task(
    "**World-v0**: a simulator, a recording or a robot; see `activestructure_gym.worlds.World`.",
    world="World or str | required | a world, or its name: `module:factory?option=value`",
)
class WorldEnv(ReconstructionEnv):
    """Explore a world: a simulator, a recording, a robot."""

    def __init__(self, *, world: World | str | None = None, **options: Unpack[EnvOptions]) -> None:
        if "scene" in options:  # the keyword of all other tasks
            raise unknown_keyword("WorldEnv.__init__", "scene", ["world"])
        _check_names(WorldEnv, options, "world")
        if not isinstance(world, str) and not is_world(world):
            raise InputError(
                "World-v0 needs a world: an object with bounds, camera, start, capture and close, or the name of a "
                f'function that makes one, as world="module:factory"; got {short_repr(world)}'
            )
        super().__init__(PREFIX + world.removeprefix(PREFIX) if isinstance(world, str) else world, **options)


def _check_alone(**given: bool) -> None:
    """Raise `InputError` if a keyword that chooses one scene was given in addition to ``layouts``."""
    for name, was in given.items():
        if was:
            raise InputError(f"layouts takes the place of {name}; give one of them")


def _layouts(count: Any, rooms: Any) -> list[Layout]:
    """Return the first ``count`` training layouts of ``asg train``; raise `InputError` for invalid arguments."""
    if not _is_whole(count) or not 1 <= count <= MAX_LAYOUTS:
        raise InputError(f"layouts must be a whole number from 1 to {MAX_LAYOUTS}, got {short_repr(count)}")
    each = (rooms,) if _is_whole(rooms) else rooms
    if not isinstance(each, Sequence) or not each or not all(_is_whole(n) and 1 <= n <= MAX_ROOMS for n in each):
        raise InputError(
            f"rooms must be a whole number from 1 to {MAX_ROOMS}, or several of them, got {short_repr(rooms)}"
        )
    return [Layout(spec) for spec in layout_specs("train", int(count), [int(n) for n in each], lit=False)]


def _is_whole(value: Any) -> bool:
    return isinstance(value, int | np.integer) and not isinstance(value, bool)


def _check_names(kind: type, options: Mapping[str, Any], *own: str) -> None:
    """Raise `UnknownKeyword` for a keyword that is neither in `EnvOptions` nor in ``own``."""
    known = EnvOptions.__annotations__.keys() | set(own)
    for name in options:
        if name not in known:
            raise unknown_keyword(f"{kind.__name__}.__init__", name, known)


def _with_loader(scene: Any, loader: str, task: str, example: str) -> Any:
    """Prefix scene paths with the name of their loader; leave `Scene` objects and prefixed specs unchanged."""
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


def _with_numbers(scene: Any, **numbers: Any) -> Any:
    """Return the scene with the options that are not None; ``scene_seed`` becomes its option ``seed``.

    Raises `InputError` for a number that is invalid or that the scene has no option for.
    """
    given = {name: number for name, number in numbers.items() if number is not None}
    for name, number in given.items():
        if not _is_whole(number) or not 0 <= number < 2**63:
            raise InputError(f"{name} must be a whole number from 0 to 2^63 - 1, got {short_repr(number)}")
    options = {name.removeprefix("scene_"): int(number) for name, number in given.items()}
    return _with_options(scene, options) if options else scene


def _with_options(scene: Any, options: dict[str, int]) -> Any:
    """Add the options to a scene spec, or to each spec of a list."""
    if isinstance(scene, list | tuple):
        return [_with_options(one, options) for one in scene]
    return with_options(scene, options)
