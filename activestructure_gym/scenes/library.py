"""Scenes by name or by file: the one function behind every ``scene=`` of environments and commands."""

from __future__ import annotations

import inspect
import os
import typing
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from types import UnionType
from typing import Any
from urllib.parse import parse_qsl

from activestructure_gym.errors import InputError, unknown_name
from activestructure_gym.registry import Registry
from activestructure_gym.scenes.matterport3d import is_matterport3d, load_matterport3d_scene
from activestructure_gym.scenes.mesh_loader import MESH_SUFFIXES, load_mesh_scene
from activestructure_gym.scenes.replica import is_replica, load_replica_scene
from activestructure_gym.scenes.scene import Scene

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
def _room(*, seed: int = 0, furnished: bool = True) -> Scene:
    from activestructure_gym.scenes.procedural import make_apartment

    return make_apartment(seed=seed, rooms=1, furnished=furnished)


@SCENES.register("apartment")
@lru_cache(maxsize=2)
def _apartment(*, seed: int = 0, rooms: int = 3, furnished: bool = True) -> Scene:
    from activestructure_gym.scenes.procedural import make_apartment

    return make_apartment(seed=seed, rooms=rooms, furnished=furnished)


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
    try:
        return target, dict(parse_qsl(query, keep_blank_values=True, strict_parsing=bool(query)))
    except ValueError as error:
        raise InputError(f"'{query}' in scene '{spec}' is not of the form key=value&key=value") from error


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
    parameters = dict(inspect.signature(factory).parameters)
    if path is not None:
        parameters.pop("path", None)
    takes_any = any(p.kind is inspect.Parameter.VAR_KEYWORD for p in parameters.values())
    known = [key for key, p in parameters.items() if p.kind not in (p.VAR_KEYWORD, p.VAR_POSITIONAL)]
    hints = _hints(factory)
    arguments = {}
    for key, value in options.items():
        if key not in known and not takes_any:
            raise unknown_name(f"option of {label}", key, known)
        arguments[key] = _typed(f"option {key} of {label}", value, hints.get(key, Any))
    missing = [k for k in known if parameters[k].default is inspect.Parameter.empty and k not in arguments]
    if missing:
        raise InputError(f"{label} needs the option {missing[0]} (as in '{name}?{missing[0]}=...')")
    return factory(path, **arguments) if path is not None else factory(**arguments)


def _hints(factory: Callable[..., Scene]) -> dict[str, Any]:
    """The type of every option: its annotation, or that of its default where there is none to be had."""
    defaults = {
        key: type(p.default)
        for key, p in inspect.signature(factory).parameters.items()
        if isinstance(p.default, bool | int | float)
    }
    try:
        return {**defaults, **typing.get_type_hints(factory)}
    except (NameError, TypeError):  # names imported for type checkers only, or a callable object
        return defaults


def _typed(what: str, value: Any, hint: Any) -> Any:
    """A text value as its annotation says; values that are no text are passed on."""
    if not isinstance(value, str):
        return value
    origin, inner = typing.get_origin(hint), typing.get_args(hint)
    if origin in (typing.Union, UnionType):
        # Numbers first: "0.01" is a number wherever a number may stand, and any text is a text.
        order = sorted(inner, key=lambda t: {bool: 0, int: 1, float: 2}.get(t, 3))
        for candidate in (t for t in order if t is not type(None)):
            try:
                return _typed(what, value, candidate)
            except InputError:
                continue
        raise InputError(f"{what} cannot be '{value}'")
    try:
        if hint is bool:
            return {"true": True, "1": True, "yes": True, "false": False, "0": False, "no": False}[value.lower()]
        if hint in (int, float):
            return hint(value)
        if origin is tuple:
            items = value.split(",")
            kinds = [inner[0]] * len(items) if inner[-1] is Ellipsis else list(inner)
            if len(items) != len(kinds):
                raise ValueError
            return tuple(_typed(what, item, kind) for item, kind in zip(items, kinds))
    except (ValueError, KeyError):
        expected = f"{len(inner)} values with commas" if origin is tuple else getattr(hint, "__name__", str(hint))
        raise InputError(f"{what} must be {expected}, got '{value}'") from None
    return value
