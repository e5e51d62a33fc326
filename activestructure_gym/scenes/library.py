"""Load scenes by name or from files, for the option ``scene`` of environments and commands."""

from __future__ import annotations

import glob
import inspect
import os
from collections.abc import Callable, Hashable, Mapping
from contextlib import suppress
from dataclasses import replace
from functools import lru_cache, wraps
from pathlib import Path
from typing import Any

import numpy as np

from activestructure_gym.errors import InputError, listed, short_repr, unknown_name
from activestructure_gym.registry import Registry
from activestructure_gym.scenes.loaders.habitat import ENDING, is_habitat, load_habitat_scene
from activestructure_gym.scenes.loaders.hm3d import is_hm3d, load_gibson_scene, load_hm3d_scene
from activestructure_gym.scenes.loaders.matterport3d import is_matterport3d, load_matterport3d_scene
from activestructure_gym.scenes.loaders.mesh_loader import MESH_SUFFIXES, check_printable, load_mesh_scene
from activestructure_gym.scenes.loaders.procthor import load_procthor_scene
from activestructure_gym.scenes.loaders.replica import is_replica, load_replica_scene
from activestructure_gym.scenes.loaders.scannet import (
    is_scannet,
    is_scannetpp,
    load_scannet_scene,
    load_scannetpp_scene,
)
from activestructure_gym.scenes.procedural.kept import kept_scene
from activestructure_gym.scenes.scene import Scene
from activestructure_gym.specs import parse_options, typed_options


def _is_factory(entry: Any) -> bool:
    try:
        inspect.signature(entry)
    except (TypeError, ValueError):  # not callable, or a builtin without a signature
        return False
    return True


# Name of an option of every scene: a point in the free-space region to use.
INSIDE = "inside"

# Factories of generated scenes take keyword options only. A factory whose first parameter is named `path` reads files;
# its name is used as a prefix, as in "mesh:house.obj?units=cm".
SCENES: Registry[Callable[..., Scene]] = Registry(
    "scene", "scenes", fits=_is_factory, wanted="a function with named options that returns a Scene"
)

SCENES.register("mesh")(load_mesh_scene)
SCENES.register("replica")(load_replica_scene)
SCENES.register("matterport3d")(load_matterport3d_scene)
SCENES.register("procthor")(load_procthor_scene)
SCENES.register("scannet")(load_scannet_scene)
SCENES.register("scannetpp")(load_scannetpp_scene)
SCENES.register("hm3d")(load_hm3d_scene)
SCENES.register("gibson")(load_gibson_scene)
SCENES.register("habitat")(load_habitat_scene)

# Tests of a path without prefix, and the loader of each; the first test that is True selects the loader.
_LAYOUTS: tuple[tuple[Callable[[Path], bool], Callable[..., Scene]], ...] = (
    (is_habitat, load_habitat_scene),
    (is_replica, load_replica_scene),
    (is_matterport3d, load_matterport3d_scene),
    (is_scannet, load_scannet_scene),
    (is_scannetpp, load_scannetpp_scene),
    (is_hm3d, load_hm3d_scene),
)


def _shared(make: Callable[..., Scene]) -> Callable[..., Scene]:
    """Return a factory that caches the two latest scenes of ``make``, which take seconds to build and never change.

    All environments of a process share these scenes and their ray casters.
    """
    kept = lru_cache(maxsize=2)(make)

    @wraps(make)
    def shared(**options: Any) -> Scene:
        return kept(**{key: _hashable(key, value) for key, value in options.items()})

    return shared


def _hashable(key: str, value: Any) -> Any:
    """Return the value of the option ``key`` with lists and arrays converted to tuples, so that it can be hashed.

    Raises `InputError` for a value that cannot be hashed.
    """
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, list):
        return tuple(_hashable(key, one) for one in value)
    if not isinstance(value, Hashable):
        raise InputError(
            f"the option {key} of a scene is a number, a truth value or a few numbers, got {short_repr(value)}"
        )
    return value


@SCENES.register("box")
@_shared
def _box(*, seed: int = 0, size: tuple[float, float, float] = (4.0, 3.0, 2.5)) -> Scene:
    from activestructure_gym.scenes.procedural.apartment import make_box_room

    return make_box_room(seed=seed, size=size)


@SCENES.register("room")
@_shared
def _room(*, seed: int = 0, furnished: bool = True, lit: bool = True) -> Scene:
    return _kept_apartment(seed=seed, rooms=1, furnished=furnished, lit=lit)


@SCENES.register("apartment")
@_shared
def _apartment(*, seed: int = 0, rooms: int = 3, furnished: bool = True, lit: bool = True) -> Scene:
    return _kept_apartment(seed=seed, rooms=rooms, furnished=furnished, lit=lit)


def _kept_apartment(**options: Any) -> Scene:
    """Return a procedural apartment, from the cache directory if it is there."""

    def make() -> Scene:
        from activestructure_gym.scenes.procedural.apartment import make_apartment

        return make_apartment(**options)

    return kept_scene("-".join(["apartment", *(f"{name}={value}" for name, value in options.items())]), make)


def load_scene(spec: str | os.PathLike[str] | Scene, **options: Any) -> Scene:
    """Return the scene that ``spec`` names.

    Parameters
    ----------
    spec
        A `Scene` (returned unchanged), a path, or a text. Forms of a text: ``apartment?seed=3&rooms=4`` (a registered
        name) or ``my_package.scenes:make`` (a factory to import). Also ``house.glb?units=cm&up=y`` (a mesh file, or the
        folder of a dataset's scene) or ``replica:room_0`` (the same with the loader named).
    **options
        Keyword arguments of the factory, and ``inside`` for any scene: a point (x, y, z) in metres in the free-space
        region to use. They override options in the text.

    Returns
    -------
    Scene
        A mesh in metres, z up.

    Raises
    ------
    InputError
        For an unknown name or option, a value of the wrong type, or a file that cannot be used.

    Examples
    --------
    >>> load_scene("box?seed=1").bounds.round(1).tolist()
    [[0.0, 0.0, 0.0], [4.0, 3.0, 2.5]]
    """
    if isinstance(spec, Scene):
        if options:
            raise InputError(f"options ({', '.join(options)}) were given with a scene that is loaded already")
        return spec
    name, factory, path, said = _resolved(spec)
    return _build(name, factory, path, {**said, **options})


def with_options(spec: str | os.PathLike[str] | Scene, options: Mapping[str, Any]) -> str:
    """Return the text of a scene with ``options`` added.

    Raises `InputError` for an option that the scene does not take or already has.
    """
    if isinstance(spec, Scene):
        raise InputError(
            f"the scene '{spec.name}' is loaded already, so its options cannot be changed: "
            f"remove {listed(list(options))}"
        )
    _, factory, _, said = _resolved(spec)
    parameters = inspect.signature(factory).parameters
    takes_any = any(p.kind is p.VAR_KEYWORD for p in parameters.values())
    for key in options:
        if key in said:
            raise InputError(f"the scene '{spec}' gives its own {key}; give it in one place")
        if key not in parameters and key != INSIDE and not takes_any:
            raise InputError(f"the scene '{spec}' has no option '{key}'; remove this option")
    more = "&".join(f"{key}={value}" for key, value in options.items())
    return f"{spec}{'&' if said else '?'}{more}"


def _resolved(spec: str | os.PathLike[str]) -> tuple[str, Callable[..., Scene], str | None, dict[str, str]]:
    """Split ``spec`` into a name for messages, the factory, the path (None unless it reads files), and the options."""
    if not isinstance(spec, str | os.PathLike):
        raise InputError(f"a scene is a name, a path or a Scene, got {short_repr(spec)}")
    if not isinstance(spec, str):
        return "", *_file_factory(Path(spec)), {}
    target, said = _split_options(spec)
    if not target.strip() or target in (f"{name}:" for name in SCENES):
        raise InputError(f"a scene is a name, a mesh file or a folder, got '{spec}'; `asg list scenes` lists the names")
    kind, _, rest = target.partition(":")
    if _is_known(target):
        name, path = (target, None) if target in SCENES else (kind, rest)
        return name, SCENES.get(name), path, said
    if _is_file(target):
        return "", *_file_factory(Path(os.path.expanduser(target))), said
    if ":" in target:
        return target, SCENES.get(target), None, said
    if os.sep in target:
        raise InputError(f"there is no scene file or folder {short_repr(target)}")
    unknown = unknown_name("scene", target, (name for name in SCENES if not _reads_files(SCENES.get(name))))
    raise InputError(f"{unknown}. It is no file or folder either")


def check_scene_name(spec: str) -> None:
    """Raise `InputError` for an unknown scene or option, or a missing file or folder; nothing is loaded."""
    name, factory, path, said = _resolved(spec)
    _arguments(_label(name, path), factory, path, said)
    if path is not None and not _exists(place := Path(os.path.expanduser(path))) and not _exists_with_suffix(place):
        raise InputError(f"there is no scene file or folder {short_repr(path)}")


def imports_code(spec: str) -> bool:
    """Return whether loading the scene would import a module named in the text, as in ``my_package.scenes:make``."""
    target, _ = _split_options(spec)
    return SCENES.imports(target) and not _is_known(target) and not _is_file(target)


def is_scene_name(spec: str) -> bool:
    """Return whether the text without options is a registered name; such a name is never treated as a file."""
    target, _ = _split_options(spec)
    return target in SCENES and not _reads_files(SCENES.get(target))


def _is_known(target: str) -> bool:
    """Return whether the text is the name of a registered scene, or a registered loader, a colon and a path."""
    kind, colon, _ = target.partition(":")
    return (bool(colon) and kind in SCENES and _reads_files(SCENES.get(kind))) or (
        target in SCENES and not _reads_files(SCENES.get(target))
    )


def _is_file(target: str) -> bool:
    """Return whether the text is a file or folder name, existing or not."""
    path = Path(os.path.expanduser(target))
    return _exists(path) or path.suffix.lower() in MESH_SUFFIXES or target.endswith((".stage_config.json", ENDING))


def _exists(path: Path) -> bool:
    """Return whether a file or folder exists; False for an invalid name."""
    try:
        return path.exists()
    except OSError:
        return False


def _exists_with_suffix(path: Path) -> bool:
    """Return whether there is a file ``path.*``; a Gibson scan is named without the suffix of its file."""
    return any(path.parent.glob(f"{glob.escape(path.name)}.*"))


def _split_options(spec: str) -> tuple[str, dict[str, str]]:
    if "?" not in spec or _exists(Path(os.path.expanduser(spec))):
        return spec, {}
    # A file name may contain a question mark too: options follow the last one.
    target, _, query = spec.rpartition("?")
    if not _exists(Path(os.path.expanduser(target))):
        target, _, query = spec.partition("?")
    return target, parse_options(query, f"scene '{spec}'")


def _file_factory(path: Path) -> tuple[Callable[..., Scene], str]:
    """Return the factory that loads a path without prefix, and the path."""
    check_printable(str(path))
    try:
        _check_name(path)
        return _layout_of(path)
    except OSError as error:
        raise InputError(f"a scene cannot be read: {error.strerror or error}: {short_repr(str(path))}") from error


def _check_name(path: str | Path) -> None:
    """Raise `OSError` for a name that no file can have; `Path.exists` returns False for it from Python 3.14 on."""
    with suppress(FileNotFoundError, NotADirectoryError, ValueError):  # the last for a null character
        os.stat(path)


def _layout_of(path: Path) -> tuple[Callable[..., Scene], str]:
    for belongs, load in _LAYOUTS:
        if belongs(path):
            return load, str(path)
    if path.is_dir():
        meshes = sorted(file for file in path.iterdir() if file.suffix.lower() in MESH_SUFFIXES)
        if len(meshes) != 1:
            inner = sorted(folder for folder in path.iterdir() if any(belongs(folder) for belongs, _ in _LAYOUTS))
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
    label = _label(name, path)
    arguments, inside = _arguments(label, factory, path, options)
    try:
        if path is not None:
            _check_name(path)
        scene = factory(path, **arguments) if path is not None else factory(**arguments)
    except OSError as error:
        if path is None:
            raise
        raise InputError(f"{label} cannot be read: {error.strerror or error}: {short_repr(path)}") from error
    if not isinstance(scene, Scene):
        raise InputError(f"{label}: its factory must return a Scene, and returned {short_repr(scene)}")
    wrong = scene.mesh.wrong()
    if wrong:
        raise InputError(f"{label}: its mesh cannot be used: {wrong}")
    return scene if inside is None else replace(scene, inside=_point_in(label, scene, inside))


def _label(name: str, path: str | None) -> str:
    return f"scene '{name}'" if name else f"scene '{path}'"


def _arguments(
    label: str, factory: Callable[..., Scene], path: str | None, options: dict[str, Any]
) -> tuple[dict[str, Any], Any]:
    """Return the keyword arguments of a scene's factory, and the value of the option ``inside`` or None.

    ``inside`` is an option of every scene, except where the factory itself has a parameter of that name.
    """
    own = INSIDE in inspect.signature(factory).parameters
    others = options if own else {key: value for key, value in options.items() if key != INSIDE}
    arguments = typed_options(label, factory, others, apart=("path",) if path is not None else (), more=(INSIDE,))
    return arguments, None if own else options.get(INSIDE)


def _point_in(label: str, scene: Scene, given: Any) -> tuple[float, float, float]:
    """Return the point of the option ``inside``; raise `InputError` unless it is three numbers within the bounds."""
    try:
        values = given.split(",") if isinstance(given, str) else list(given)
        x, y, z = (float(value) for value in values)
    except (TypeError, ValueError):
        x = y = z = float("nan")
    if not np.isfinite([x, y, z]).all():
        raise InputError(
            f"the option inside of {label} is a point of free space, three numbers x,y,z in metres, got "
            f"{short_repr(given)}"
        )
    low, high = scene.bounds
    if (np.array([x, y, z]) < low).any() or (np.array([x, y, z]) > high).any():
        box = " to ".join(f"({', '.join(f'{value:.2f}' for value in corner)})" for corner in (low, high))
        raise InputError(
            f"the option inside of {label} is a point in the scene's bounds, {box} m, got {x:g},{y:g},{z:g}"
        )
    return x, y, z
