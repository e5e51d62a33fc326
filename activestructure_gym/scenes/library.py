"""Scenes by name or by file: the one function behind every ``scene=`` of environments and commands."""

from __future__ import annotations

import inspect
import os
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any

from activestructure_gym.errors import InputError, unknown_name
from activestructure_gym.registry import Registry
from activestructure_gym.scenes.matterport3d import is_matterport3d, load_matterport3d_scene
from activestructure_gym.scenes.mesh_loader import MESH_SUFFIXES, load_mesh_scene
from activestructure_gym.scenes.replica import is_replica, load_replica_scene
from activestructure_gym.scenes.scene import Scene
from activestructure_gym.specs import parse_options, typed_options

# Factories of generated scenes take keyword options only. A factory whose first parameter is called `path` reads
# files: its name becomes a prefix, as in "mesh:house.obj?units=cm".
SCENES: Registry[Callable[..., Scene]] = Registry("scene", "scenes")

SCENES.register("mesh")(load_mesh_scene)
SCENES.register("replica")(load_replica_scene)
SCENES.register("matterport3d")(load_matterport3d_scene)


# Generated scenes take seconds to build and never change: the last two of each kind are shared by all envs of a
# process, ray caster and all.
@SCENES.register("box")
@lru_cache(maxsize=2)
def _box(*, seed: int = 0, size: tuple[float, float, float] = (4.0, 3.0, 2.5)) -> Scene:
    from activestructure_gym.scenes.procedural import make_box_room

    return make_box_room(seed=seed, size=size)


@SCENES.register("room")
@lru_cache(maxsize=2)
def _room(*, seed: int = 0, furnished: bool = True, lit: bool = True) -> Scene:
    from activestructure_gym.scenes.procedural import make_apartment

    return make_apartment(seed=seed, rooms=1, furnished=furnished, lit=lit)


@SCENES.register("apartment")
@lru_cache(maxsize=2)
def _apartment(*, seed: int = 0, rooms: int = 3, furnished: bool = True, lit: bool = True) -> Scene:
    from activestructure_gym.scenes.procedural import make_apartment

    return make_apartment(seed=seed, rooms=rooms, furnished=furnished, lit=lit)


def load_scene(spec: str | os.PathLike[str] | Scene, **options: Any) -> Scene:
    """The scene that ``spec`` names.

    Args:
        spec: a `Scene` (returned as it is), a path, or a text of one of the forms
            ``apartment?seed=3&rooms=4`` (a registered name), ``my_package.scenes:make`` (a factory anywhere),
            ``house.glb?units=cm&up=y`` (a mesh file, or the folder of a Replica or Matterport3D scene),
            ``replica:room_0`` (the same with the kind said).
        **options: keyword arguments of the factory; they win over options in the text.

    Raises:
        InputError: unknown name or option, a value of the wrong kind, or a file that cannot be used.
    """
    if isinstance(spec, Scene):
        if options:
            raise InputError(f"options ({', '.join(options)}) were given with a scene that is loaded already")
        return spec
    if not isinstance(spec, str):
        return _build("", *_file_factory(Path(spec)), options)
    target, text_options = _split_options(spec)
    if not target.strip() or target in (f"{name}:" for name in SCENES):
        raise InputError(f"a scene is a name, a mesh file or a folder, got '{spec}'; `asg scenes` lists the names")
    kind, colon, rest = target.partition(":")
    if colon and kind in SCENES and _reads_files(SCENES.get(kind)):
        return _build(kind, SCENES.get(kind), rest, {**text_options, **options})
    if target in SCENES and not _reads_files(SCENES.get(target)):
        return _build(target, SCENES.get(target), None, {**text_options, **options})
    path = Path(target).expanduser()
    if path.exists() or path.suffix.lower() in MESH_SUFFIXES or target.endswith(".stage_config.json"):
        return _build("", *_file_factory(path), {**text_options, **options})
    if colon:
        return _build(target, SCENES.get(target), None, {**text_options, **options})
    if os.sep in target:
        raise InputError(f"there is no scene file or folder '{target}'")
    raise unknown_name("scene", target, (name for name in SCENES if not _reads_files(SCENES.get(name))))


def _split_options(spec: str) -> tuple[str, dict[str, str]]:
    if "?" not in spec or Path(spec).expanduser().exists():
        return spec, {}
    # The name of a file may hold a question mark too: the options stand behind the last one.
    target, _, query = spec.rpartition("?")
    if not Path(target).expanduser().exists():
        target, _, query = spec.partition("?")
    return target, parse_options(query, f"scene '{spec}'")


def _file_factory(path: Path) -> tuple[Callable[..., Scene], str]:
    """What loads a bare path."""
    if is_replica(path):
        return load_replica_scene, str(path)
    if is_matterport3d(path):
        return load_matterport3d_scene, str(path)
    if path.is_dir():
        meshes = sorted(file for file in path.iterdir() if file.suffix.lower() in MESH_SUFFIXES)
        if len(meshes) != 1:
            inner = sorted(folder for folder in path.iterdir() if is_replica(folder) or is_matterport3d(folder))
            if inner and not meshes:
                shown = ", ".join(str(folder) for folder in inner[:5])
                raise InputError(f"'{path}' is a folder of scenes; give one of them: {shown}")
            found = f"it holds {', '.join(m.name for m in meshes[:5])}" if meshes else "it holds no mesh file"
            raise InputError(f"'{path}' is a folder of no known scene layout, and {found}; name the mesh file")
        return load_mesh_scene, str(meshes[0])
    return load_mesh_scene, str(path)


def _reads_files(factory: Callable[..., Scene]) -> bool:
    return next(iter(inspect.signature(factory).parameters), None) == "path"


def _build(name: str, factory: Callable[..., Scene], path: str | None, options: dict[str, Any]) -> Scene:
    label = f"scene '{name}'" if name else f"scene '{path}'"
    arguments = typed_options(label, factory, options, apart=("path",) if path is not None else ())
    return factory(path, **arguments) if path is not None else factory(**arguments)
