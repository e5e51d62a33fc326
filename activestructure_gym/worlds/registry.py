"""Register worlds by name: ``world:recorded?path=FOLDER``, ``world:package.module:factory?option=value``."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from activestructure_gym.errors import InputError, short_repr
from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.registry import Registry
from activestructure_gym.specs import Spec, typed_options
from activestructure_gym.worlds.base import World, is_world
from activestructure_gym.worlds.reliable import Reliable, check_limits

if TYPE_CHECKING:
    from activestructure_gym.config import ReconstructionConfig

PREFIX = "world:"

# Functions, or classes, that make a world; their parameters are the options of its name.
WORLDS: Registry[Callable[..., World]] = Registry(
    "world", "worlds", fits=callable, wanted="a function that returns a World", files=("worlds/*_world.py",)
)


def names_world(scene: Any) -> bool:
    """Return whether a scene's name is that of a world: ``world:NAME``."""
    return isinstance(scene, str) and scene.startswith(PREFIX)


def check_world_name(name: str) -> None:
    """Raise `InputError` for an unknown world or a wrong option; make none, and import no code that the name names."""
    spec = Spec(name.removeprefix(PREFIX))
    options = spec.options(f"world '{spec.name}'")
    if not WORLDS.imports(spec.name):
        _arguments(spec, WORLDS.get(spec.name), options)


def load_world(name: str) -> World:
    """Make a world by its name. The options ``tries`` and ``timeout_s`` are those of `Reliable`.

    Parameters
    ----------
    name
        A registered name or ``package.module:factory``, with options after a question mark and with or without the
        prefix ``world:``. The options are the parameters of the function.

    Returns
    -------
    World
        A new world.

    Raises
    ------
    InputError
        An unknown name or option, or a function that returns no world.
    """
    spec = Spec(name.removeprefix(PREFIX) if isinstance(name, str) else name)
    make = WORLDS.get(spec.name)
    label = f"world '{spec.name}'"
    options, limits = _arguments(spec, make, spec.options(label))
    made = make(**options)
    if not is_world(made):
        raise InputError(
            f"{label} must return an object with bounds, camera, start, capture and close, got {short_repr(made)}"
        )
    return Reliable(made, **limits) if limits else made


def _arguments(
    spec: Spec, make: Callable[..., World], options: dict[str, str]
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the keyword arguments of a world's function, and those of `Reliable`, from the options of its name."""
    label = f"world '{spec.name}'"
    limits: dict[str, Any] = {name: options.pop(name) for name in ("tries", "timeout_s") if name in options}
    try:
        options, limits = typed_options(label, make, options), typed_options(label, Reliable, limits, apart=("world",))
    except InputError:
        raise
    except ValueError as error:  # a built-in type has no signature
        raise InputError(f"{label} cannot be made: {error}") from error
    check_limits(**limits)
    return options, limits


def with_camera(config: ReconstructionConfig, camera: PinholeCamera) -> ReconstructionConfig:
    """Return the configuration with the sensor's size and intrinsics replaced by those of ``camera``."""
    if config.sensor.camera == camera:
        return config
    lens = (camera.fx, camera.fy, camera.cx, camera.cy)
    sensor = dataclasses.replace(config.sensor, width=camera.width, height=camera.height, intrinsics=lens)
    return dataclasses.replace(config, sensor=sensor)
