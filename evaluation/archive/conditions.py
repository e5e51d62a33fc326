"""Define the conditions that all runs of a comparison share."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from numbers import Integral
from typing import TYPE_CHECKING, Any, cast

from activestructure_gym.errors import InputError, short_repr
from activestructure_gym.evaluation.archive.json_files import plain
from activestructure_gym.evaluation.protocols import PROTOCOLS, StandardProtocol, get_protocol, protocol_from
from activestructure_gym.evaluation.protocols.metrics import METRICS, get_metric
from activestructure_gym.policies.native_settings import NATIVE_PRESET, Setup, native_settings_of

if TYPE_CHECKING:
    from activestructure_gym.config import Preset
    from activestructure_gym.policies import Policy


@dataclass(frozen=True)
class Conditions:
    """Hold the conditions of an episode and its measurement: everything except scene, policy and seed.

    Parameters
    ----------
    preset
        ``"rl"``, ``"fast"``, ``"default"``, ``"full"`` or ``"paper"``. Default: ``"default"``, in the native setup
        ``"full"``.
    frame_budget
        Frames per episode, including the first one. Default: the preset's.
    overrides
        Changes of the preset by field, for example ``{"sensor.depth_noise": "kinect"}``.
    start_pose
        Start of every episode in the world frame: x, y, z in metres and yaw in degrees (0 = +x). Default: drawn from
        the seed.
    protocol
        The protocol that measures every finished map.
    also
        Further protocols with their default constants, by name: ``("activegamer",)``, ``("mine:Protocol",)``.
    metrics
        Further metrics, by name: registered, or ``("mine:worst_tenth",)``.
    setup
        ``"shared"`` (equal candidates, keyframes and mapper) or ``"native"`` (each policy's own).

    Examples
    --------
    >>> from activestructure_gym.evaluation import Conditions
    >>> Conditions(setup="native", frame_budget=100).preset
    'full'
    """

    preset: Preset = None  # type: ignore[assignment]
    frame_budget: int | None = None
    overrides: Mapping[str, Any] = field(default_factory=dict, hash=False)
    start_pose: tuple[float, float, float, float] | None = None
    protocol: StandardProtocol = field(default_factory=StandardProtocol)
    also: tuple[str, ...] = ()
    metrics: tuple[str, ...] = ()
    setup: Setup = "shared"

    def __post_init__(self) -> None:
        if self.frame_budget is not None:
            if isinstance(self.frame_budget, bool) or not isinstance(self.frame_budget, Integral):
                raise InputError(f"the frame budget must be a whole number, got {short_repr(self.frame_budget)}")
            if self.frame_budget < 1:
                raise InputError(f"the frame budget must be at least 1, got {self.frame_budget}")
            object.__setattr__(self, "frame_budget", int(self.frame_budget))
        for kind, names in (("also", self.also), ("metrics", self.metrics)):
            if isinstance(names, str) or not isinstance(names, Iterable):
                raise InputError(f"{kind} is a list of names, got {short_repr(names)}")
        try:
            overrides = dict(self.overrides)
        except (TypeError, ValueError):
            given = short_repr(self.overrides)
            raise InputError(f"overrides are values by field, as {{'mapper.iterations': 8}}, got {given}") from None
        if not isinstance(self.protocol, StandardProtocol):
            raise InputError(f"protocol must be StandardProtocol(...), got {short_repr(self.protocol)}")
        if self.protocol.name != StandardProtocol.name:
            raise InputError(
                f"the first protocol of a run must be '{StandardProtocol.name}', got '{self.protocol.name}': name "
                "further protocols in `also`"
            )
        if self.protocol.name in self.also:
            raise InputError(f"protocol '{self.protocol.name}' measures every run already; name only others")
        for name in self.also:
            if not PROTOCOLS.imports(str(name)):
                PROTOCOLS.get(name)
        for name in self.metrics:
            if not METRICS.imports(str(name)):
                get_metric(name)
        native_settings_of(None, self.setup)
        if self.preset is None:
            object.__setattr__(self, "preset", NATIVE_PRESET if self.setup == "native" else "default")
        if self.start_pose is not None:
            object.__setattr__(self, "start_pose", _checked_start(self.start_pose))
        object.__setattr__(self, "also", tuple(sorted(set(self.also))))
        object.__setattr__(self, "metrics", tuple(sorted(set(self.metrics))))
        object.__setattr__(self, "overrides", dict(sorted((str(k), v) for k, v in overrides.items())))

    def as_dict(self) -> dict[str, Any]:
        """Return the conditions as plain values for JSON.

        ``setup`` is omitted if it is "shared", and ``metrics`` if there are none. A protocol in ``also`` that is named
        as ``module:Class`` is stored by its name alone, so that its module is not imported.
        """
        content = {one.name: getattr(self, one.name) for one in dataclasses.fields(self)}
        content["overrides"] = dict(self.overrides)
        content["protocol"] = self.protocol.parameters()
        content["also"] = [
            {"name": name} if PROTOCOLS.imports(name) else get_protocol(name).parameters() for name in self.also
        ]
        if self.setup == "shared":
            del content["setup"]
        if not self.metrics:
            del content["metrics"]
        return dict(plain(content))

    @classmethod
    def from_dict(cls, content: Mapping[str, Any]) -> Conditions:
        """Create the conditions from ``content``, the result of `as_dict`."""
        values = dict(content)
        protocol = cast(StandardProtocol, protocol_from(values.pop("protocol")))
        also = tuple(
            one["name"] if PROTOCOLS.imports(one["name"]) else protocol_from(one).name for one in values.pop("also")
        )
        start_pose = values.pop("start_pose")
        overrides = {k: tuple(v) if isinstance(v, list) else v for k, v in values.pop("overrides").items()}
        start_pose = None if start_pose is None else tuple(start_pose)
        metrics = tuple(values.pop("metrics", ()))
        return cls(**values, overrides=overrides, start_pose=start_pose, protocol=protocol, also=also, metrics=metrics)

    def changes(self, policy: Policy | type[Policy] | None) -> dict[str, Any]:
        """Return the changes of the preset by field: the policy's own settings in this setup, then the overrides."""
        return native_settings_of(policy, self.setup).overrides() | dict(self.overrides)

    def env_options(self, changes: Mapping[str, Any]) -> dict[str, Any]:
        """Return the arguments of `ReconstructionEnv`, except scene and features, for these changes of the preset.

        ``coverage_target`` is None, because the observed share of the surface is ground truth: no policy may use it.
        """
        return {
            "preset": self.preset,
            "frame_budget": self.frame_budget,
            "config": dict(changes),
            "coverage_target": None,
            "start_pose": self.start_pose,
        }


def _checked_start(given: Any) -> tuple[float, float, float, float]:
    numbers = plain(list(given)) if isinstance(given, Iterable) else []  # NaN and infinity become None
    if len(numbers) != 4 or not all(isinstance(one, int | float) for one in numbers):
        raise InputError(f"a start pose is x, y, z in metres and yaw in degrees, got {short_repr(given)}")
    x, y, z, yaw = numbers
    return x, y, z, yaw
