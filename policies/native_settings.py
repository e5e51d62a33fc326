"""Define the configuration that a planner uses in the native setup: candidate views, keyframes, mapper, clearance."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, get_args

from activestructure_gym.errors import InputError, unknown_name
from activestructure_gym.specs import Spec

Setup = Literal["shared", "native"]
# Default preset of the native setup. It has the paper's frame budget, and an image size that a CPU maps in minutes.
NATIVE_PRESET: Literal["full"] = "full"


# Fields of the configuration that `NativeSettings` has under a name of its own.
_FIELDS = (
    "mapper.name", "views.stages", "views.max_candidates", "keyframe_every", "mapper.iterations",
    "motion.candidate_clearance",
)  # fmt: skip


@dataclass(frozen=True)
class NativeSettings:
    """Define the candidate sources, mapper and schedule of a planner's paper; None keeps the default of a field."""

    mapper: str | None = None  # name in `MAPPERS`, such as ``splatam``
    stages: tuple[tuple[str, ...], ...] | None = None  # candidate sources by stage, see ``views.stages``
    candidates: int | None = None  # rows of the candidate table
    keyframe_every: int | None = None  # frames between keyframes
    goal_keyframes: bool = False  # map only the frame at the end of each path
    iterations: int | None = None  # mapper iterations per keyframe
    clearance_m: float | None = None  # minimum distance in metres of a view to space not known to be free
    changes: Mapping[str, Any] = field(default_factory=dict)  # other fields of the configuration, by name
    budget: str = ""  # budget of the paper, as text: frames, image size, iterations

    def __post_init__(self) -> None:
        named = {"frame_budget": "all planners have the same", "features": "the policy's required_features"}
        named |= {name: "it has a field of NativeSettings" for name in _FIELDS}
        if taken := [name for name in self.changes if name in named]:
            raise InputError(f"changes of NativeSettings cannot set {taken[0]}: {named[taken[0]]}")
        if not self.goal_keyframes:
            return
        if self.keyframe_every is not None:
            raise InputError(f"give goal_keyframes or keyframe_every, not both (keyframe_every={self.keyframe_every})")
        if staying := [name for stage in self.stages or () for name in stage if Spec(name).name == "stay"]:
            raise InputError(
                f"a round of '{staying[0]}' costs the frames between two keyframes, and with goal_keyframes this "
                "number is not defined: set keyframe_every instead"
            )

    def describe(self) -> str:
        """Return the settings as one line of text, with the paper's budget if it is given."""
        frames = "at the end of a path" if self.goal_keyframes else f"every {self.keyframe_every} frames"
        given = {
            "views of " + " or ".join(" + ".join(stage) for stage in self.stages or ()): self.stages,
            f"up to {self.candidates} of them": self.candidates,
            f"views {self.clearance_m} m from what is not free": self.clearance_m,
            f"mapper {self.mapper}": self.mapper,
            f"{self.iterations} iterations a keyframe": self.iterations,
            f"a keyframe {frames}": True if self.goal_keyframes else self.keyframe_every,
            ", ".join(f"{name} = {value}" for name, value in self.changes.items()): self.changes or None,
        }
        settings = ", ".join(text for text, value in given.items() if value is not None) or "nothing"
        return f"{settings}; budget in its paper: {self.budget}" if self.budget else settings

    def overrides(self) -> dict[str, Any]:
        """Return the settings as overrides of the env's configuration, by field name such as ``views.stages``."""
        every = 10**6 if self.goal_keyframes else self.keyframe_every  # the last frame of a path is always a keyframe
        values = (self.mapper, self.stages, self.candidates, every, self.iterations, self.clearance_m)
        given = dict(zip(_FIELDS, values))
        return {name: value for name, value in given.items() if value is not None} | dict(self.changes)


def native_settings_of(policy: Any, setup: Setup) -> NativeSettings:
    """Return the settings of ``policy`` (a policy or its class) in a setup; in the shared setup they are empty.

    Raises `InputError` for an unknown setup, or if ``native_settings`` of the policy is no `NativeSettings`.
    """
    if setup not in get_args(Setup):
        raise unknown_name("setup", str(setup), get_args(Setup))
    settings = getattr(policy, "native_settings", NativeSettings())
    if not isinstance(settings, NativeSettings):
        name = getattr(policy, "__name__", type(policy).__name__)
        raise InputError(f"native_settings of {name} must be a NativeSettings, got {type(settings).__name__}")
    return settings if setup == "native" else NativeSettings()


# The camera of planners that were written for Habitat's challenges: 256 x 256 pixels, 90 x 90 degrees.
SQUARE_CAMERA = {"sensor.width": 256, "sensor.height": 256}

# Settings of the ActiveStructure paper, which runs all compared systems with SplaTAM's mapper. It names neither image
# size nor iterations; these are those of ActiveGAMER.
SPLATAM = NativeSettings(
    mapper="splatam", iterations=15, budget="2000 frames (Sec. 4.1); 1200 x 680 and 15 iterations as ActiveGAMER"
)

# Settings of planners whose papers select views one by one from a given data set; the shared pool replaces the data
# set. No frame is mapped along the path, and each view gets 100 iterations before the next selection
# (`interval_epochs`, [fisherrf, code]). The original code runs 100 iterations per view held, so its rounds grow. Views
# are scored at the size of the images, as there. At a quarter of it, Gaussians are blurred: from 4 m to 1 m, the
# information about their scales grows 3.9 times instead of 1.3 times. A view is selected once.
SELECTED_VIEWS = NativeSettings(
    goal_keyframes=True,
    iterations=100,
    changes={"views.scoring_scale": 1.0, "views.max_revisits": 0},
    budget="10 or 20 views out of a data set",
)
