"""Define the configuration of an episode: one frozen dataclass per room, named presets, overrides by field."""

from __future__ import annotations

import dataclasses
import math
import numbers
import typing
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Any, Literal, TypeVar

from activestructure_gym.errors import InputError, short_repr, unknown_name
from activestructure_gym.features import column_names
from activestructure_gym.mapping import BaseMapperConfig, MapperConfig
from activestructure_gym.mapping.registry import mapper_config
from activestructure_gym.motion import SAMPLING_DIP, MotionConfig
from activestructure_gym.planes import PlaneGraphConfig
from activestructure_gym.ranges import MAX_FRAMES, check_ranges
from activestructure_gym.sensors import SensorConfig
from activestructure_gym.sources import make_stages
from activestructure_gym.views import ViewConfig
from activestructure_gym.volume import VolumeConfig

T = TypeVar("T")


@dataclass(frozen=True)
class ReconstructionConfig:
    """Configure an episode: everything that determines it except scene, seed and policy."""

    frame_budget: int = 300  # frames per episode, the first one included; the paper uses 2000
    keyframe_every: int = 5  # frames; SplaTAM's and ActiveGAMER's schedule
    revisit_rounds: int = 4  # factor on the mapper's iterations at a revisited keyframe (own choice)
    features: tuple[str, ...] = ("pixel",)  # features computed for every candidate; stored as column names
    sensor: SensorConfig = field(default_factory=SensorConfig)  # the RGB-D camera and its noise
    mapper: BaseMapperConfig = field(default_factory=MapperConfig)  # how the Gaussian map grows
    volume: VolumeConfig = field(default_factory=VolumeConfig)  # the voxel grid of free and occupied space
    planes: PlaneGraphConfig = field(default_factory=PlaneGraphConfig)  # the Plane Scene Graph
    motion: MotionConfig = field(default_factory=MotionConfig)  # the agent's body and its steps
    views: ViewConfig = field(default_factory=ViewConfig)  # which candidates are generated

    def __post_init__(self) -> None:
        _check_kind("frame_budget", self.frame_budget, int)
        if self.frame_budget < 1:
            raise InputError(
                f"the frame budget must be at least 1, got {self.frame_budget}: every frame the camera moves costs one"
            )
        if self.frame_budget > MAX_FRAMES:
            raise InputError(f"the frame budget must be at most {MAX_FRAMES}, got {short_repr(self.frame_budget)}")
        check_ranges(self, {"keyframe_every": f"[1, {MAX_FRAMES}]", "revisit_rounds": "[1, 1000]"})
        factor, width, height = self.mapper.keyframe_reduction, self.sensor.width, self.sensor.height
        if width % factor or height % factor:
            raise InputError(
                f"mapper.keyframe_reduction must divide the sensor's {width} x {height} pixels, got {factor}; choose a "
                "common divisor"
            )
        overlooked = SAMPLING_DIP * self.volume.voxel_size
        if not self.motion.min_clearance > overlooked:
            raise InputError(
                f"motion.min_clearance must be above {overlooked:.3g} m, {SAMPLING_DIP:.2f} of volume.voxel_size, got "
                f"{self.motion.min_clearance}. Between the samples of a path the clearance may drop by this much, so a "
                "smaller limit would block no path: raise min_clearance or use smaller voxels"
            )
        object.__setattr__(self, "features", column_names(self.features))
        make_stages(self.views.stages, self.views.max_candidates)


Preset = Literal["rl", "fast", "default", "full", "paper"]

# 2000 frames leave time for surfaces that the default pool cannot see, such as those under and behind objects
# (docs/notebook/lab_notes.md).
_FINE_POOL = {"lattice_step_m": 0.25, "heights_m": (-1.0, -0.5, 0.0, 0.5, 0.8)}
_CLOSE_BY = {"candidate_clearance": 0.2}

# For learning and tests: small images, few keyframes, few candidates. Gaussians are seeded from depth and never
# optimised (docs/notebook/performance.md, "Environment for learning").
_FAST: dict[str, Any] = {
    "frame_budget": 100,
    "keyframe_every": 20,
    "sensor": {"width": 96, "height": 54, "supersample": 1},
    # Seeds depend on depth alone, so training can skip rendering colour.
    "mapper": {
        "iterations": 0,
        "psnr_refresh": 0,
        "seed_spacing": 0.12,
        "seed_pixels": 4.0,
        "texture_contrast": 1.0,
    },
    "views": {"max_candidates": 64, "max_revisits": 0, "heights_m": (0.0,), "scoring_scale": 0.25},
}

# Overrides of the field defaults.
PRESETS: dict[Preset, dict[str, Any]] = {
    # For learners that read depth and volume alone: `fast` without Gaussians and planes.
    "rl": {**_FAST, "mapper": {**_FAST["mapper"], "enabled": False}, "planes": {"enabled": False}},
    "fast": _FAST,
    # For comparisons on a CPU.
    "default": {},
    # The paper's frame budget at an image size that a CPU maps in minutes. Candidates are scored, and Gaussians seeded,
    # at the default's resolution.
    "full": {
        "frame_budget": 2000,
        "sensor": {"width": 320, "height": 180},
        "mapper": {"iterations": 10, "seed_pixels": 2.4},
        "views": {"scoring_scale": 0.25, **_FINE_POOL},
        "motion": _CLOSE_BY,
    },
    # The paper's field of view and frame budget (Sec. 4.1), and ActiveGAMER's image size and iterations. The optimiser
    # renders 300 x 170 pixels, and seeds are spaced for that size: every pixel can seed a Gaussian
    # (docs/notebook/performance.md).
    "paper": {
        "frame_budget": 2000,
        "sensor": {"width": 1200, "height": 680, "supersample": 1},
        "mapper": {"iterations": 15, "keyframe_reduction": 4, "seed_pixels": 4.8},
        "views": {"scoring_scale": 0.0625, **_FINE_POOL},
        "motion": _CLOSE_BY,
    },
}


def known_preset(name: str) -> Preset:
    """Return ``name`` if it is a preset; raise `InputError` naming the nearest one otherwise."""
    for preset in PRESETS:
        if name == preset:
            return preset
    raise unknown_name("preset", name, PRESETS)


def configure(preset: Preset = "default", overrides: Mapping[str, Any] | None = None) -> ReconstructionConfig:
    """Return a preset with some fields replaced: ``{"sensor": {"width": 96}}`` or ``{"sensor.width": 96}``.

    ``{"mapper.name": "splatam"}`` starts from that entry of `MAPPERS`. The preset's fields, as far as this mapper has
    them, and then the given fields override it.

    Parameters
    ----------
    preset
        ``"rl"`` (learning, without Gaussians and planes), ``"fast"`` (learning and tests), ``"default"``, ``"full"``
        (2000 frames of 320 x 180) or ``"paper"`` (the paper's sizes).
    overrides
        Fields to replace, nested or with dots.

    Returns
    -------
    ReconstructionConfig
        Checked, frozen, hashable.

    Raises
    ------
    InputError
        For an unknown preset or field (names the nearest one), or a value outside a field's range.

    Examples
    --------
    >>> configure("fast", {"sensor.width": 96, "mapper": {"iterations": 4}}).sensor.width
    96
    """
    overridden = PRESETS[known_preset(preset)]
    if overrides is not None and not isinstance(overrides, Mapping):
        raise InputError(f"overrides must be a dictionary with field names as keys, got {short_repr(overrides)}")
    try:
        changes = _nested(overrides or {})
        mapper = _recipe(changes.get("mapper"))
        own = {name: value for name, value in overridden.get("mapper", {}).items() if hasattr(mapper, name)}
        return replaced(replaced(ReconstructionConfig(mapper=mapper), {**overridden, "mapper": own}), changes)
    except InputError:
        raise
    except (TypeError, ValueError) as error:
        raise InputError(f"this configuration cannot be used: {error}") from error


def _recipe(changes: Any) -> BaseMapperConfig:
    """Return the mapper configuration that the fields of group ``mapper`` override."""
    name = changes.get("name", "default") if isinstance(changes, Mapping) else "default"
    return mapper_config(name)


def replaced(config: T, overrides: Mapping[str, Any]) -> T:
    """Return a copy of a (nested) frozen dataclass with the named fields replaced."""
    hints = _hints(type(config))  # type: ignore[arg-type]
    names = {f.name for f in dataclasses.fields(config)}  # type: ignore[arg-type]
    changes = {}
    for name, value in overrides.items():
        if name not in names:
            raise unknown_name(f"field of {type(config).__name__}", name, names)
        current = getattr(config, name)
        if dataclasses.is_dataclass(current) and isinstance(value, Mapping):
            value = replaced(current, value)
        elif isinstance(current, tuple) and isinstance(value, list):
            value = tuple(value)  # JSON and TOML have no tuples
        _check_kind(f"{type(config).__name__}.{name}", value, hints[name])
        changes[name] = value
    return dataclasses.replace(config, **changes)  # type: ignore[type-var]


@cache
def _hints(kind: type) -> dict[str, Any]:
    """Return the types of the fields of a dataclass; resolving their texts is slow."""
    return typing.get_type_hints(kind)


def _check_kind(what: str, value: Any, hint: Any) -> None:
    """Raise `InputError` for a value of the wrong type, which would fail only in the middle of an episode."""
    kinds = {int: "a whole number", float: "a finite number", bool: "true or false", str: "a text", tuple: "a list"}
    kind = typing.get_origin(hint) or hint
    if dataclasses.is_dataclass(kind):
        good, expected = isinstance(value, kind), "a group of fields"  # type: ignore[arg-type]
    elif kind in (int, float):
        good = isinstance(value, numbers.Integral if kind is int else numbers.Real) and not isinstance(value, bool)
        good = good and abs(value) < math.inf  # infinity and NaN are refused: neither is below math.inf in magnitude
        expected = kinds[kind]
    elif kind in kinds:
        good, expected = isinstance(value, kind), kinds[kind]
    else:  # unions and literals are checked by the dataclass itself
        return
    if not good:
        raise InputError(f"{what} must be {expected}, got {short_repr(value)}")


def _nested(overrides: Mapping[str, Any]) -> dict[str, Any]:
    """Expand ``{"sensor.width": 96}`` to ``{"sensor": {"width": 96}}``, in new dictionaries."""
    result: dict[str, Any] = {}
    for key, value in overrides.items():
        *path, last = key.split(".")
        target = result
        for part in path:
            target = target.setdefault(part, {})
            if not isinstance(target, dict):
                raise InputError(
                    f"{short_repr(key)} sets a field of {part}, which is also set as a whole; give one of them"
                )
        target[last] = _merged(target.get(last), value)
    return result


def _merged(before: Any, value: Any) -> Any:
    """Return a copy of ``value`` merged over ``before``; ``value`` overrides shared fields."""
    if not isinstance(value, Mapping):
        return value
    found = dict(before) if isinstance(before, dict) else {}
    return found | {name: _merged(found.get(name), each) for name, each in value.items()}
