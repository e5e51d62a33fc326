"""What a planner brings besides its rule when it is compared on its own terms: views, keyframes, mapper, clearance."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, get_args

from activestructure_gym.errors import InputError, unknown_name
from activestructure_gym.specs import Spec

Setup = Literal["shared", "native"]
# Preset of the native setup unless a planner names another: the paper's budget, at a size that a CPU maps in minutes.
NATIVE_PRESET: Literal["full"] = "full"


@dataclass(frozen=True)
class NativeSettings:
    """A planner's own candidate sources and schedule, as changes of the configuration. None leaves what is usual."""

    mapper: str | None = None  # a recipe of `MAPPERS`, such as ``splatam``
    stages: tuple[tuple[str, ...], ...] | None = None  # candidate sources, see ``views.stages``
    candidates: int | None = None  # rows of the table
    keyframe_every: int | None = None  # frames
    goal_keyframes: bool = False  # a frame is mapped at the end of a way alone
    iterations: int | None = None  # of the mapper per keyframe
    clearance_m: float | None = None  # of a view to all that is not known to be free
    changes: Mapping[str, Any] = field(default_factory=dict)  # further fields of the configuration
    budget: str = ""  # what its paper spends, for people: frames, image size, iterations

    def __post_init__(self) -> None:
        if not self.goal_keyframes:
            return
        if self.keyframe_every is not None:
            raise InputError(f"give goal_keyframes or keyframe_every, not both (keyframe_every={self.keyframe_every})")
        if staying := [name for stage in self.stages or () for name in stage if Spec.of(name).name == "stay"]:
            raise InputError(
                f"a round of '{staying[0]}' costs the frames between two keyframes, and goal_keyframes leave no "
                "such number: set keyframe_every instead"
            )

    def describe(self) -> str:
        """What it brings, in words, and what its paper spends where that is noted."""
        frames = "at the end of a way" if self.goal_keyframes else f"every {self.keyframe_every} frames"
        given = {
            "views of " + " or ".join(" + ".join(stage) for stage in self.stages or ()): self.stages,
            f"up to {self.candidates} of them": self.candidates,
            f"views {self.clearance_m} m from what is not free": self.clearance_m,
            f"mapper {self.mapper}": self.mapper,
            f"{self.iterations} iterations a keyframe": self.iterations,
            f"a keyframe {frames}": True if self.goal_keyframes else self.keyframe_every,
            ", ".join(f"{name} = {value}" for name, value in self.changes.items()): self.changes or None,
        }
        brought = ", ".join(text for text, value in given.items() if value is not None) or "nothing"
        return f"{brought}; its paper spends {self.budget}" if self.budget else brought

    def overrides(self) -> dict[str, Any]:
        """The changes of the configuration, by field."""
        every = 10**6 if self.goal_keyframes else self.keyframe_every  # the last frame of a way always is a keyframe
        given = {
            "mapper.name": self.mapper,
            "views.stages": self.stages,
            "views.max_candidates": self.candidates,
            "keyframe_every": every,
            "mapper.iterations": self.iterations,
            "motion.candidate_clearance": self.clearance_m,
        }
        return {name: value for name, value in given.items() if value is not None} | dict(self.changes)


def native_settings_of(policy: Any, setup: Setup) -> NativeSettings:
    """What ``policy``, a class or an object, brings in this setup: nothing in the shared one.

    Raises `InputError` for an unknown setup, and for a declaration that is no `NativeSettings`.
    """
    if setup not in get_args(Setup):
        raise unknown_name("setup", str(setup), get_args(Setup))
    brought = getattr(policy, "native_settings", NativeSettings())
    if not isinstance(brought, NativeSettings):
        name = getattr(policy, "__name__", type(policy).__name__)
        raise InputError(f"what {name} brings must be a NativeSettings, got {type(brought).__name__}")
    return brought if setup == "native" else NativeSettings()


# All active systems that the paper compares, and its own, map by SplaTAM's recipe with 15 iterations (Sec. 4.1).
SPLATAM = NativeSettings(mapper="splatam", iterations=15, budget="2000 frames of 1200 x 680, 15 iterations (Sec. 4.1)")

# Selectors of views, which pick one after the other out of a given set: nothing is mapped on the way, and a map is
# optimised for 100 iterations per view before the next one is picked (`interval_epochs`, [fisherrf, code]; there 100
# for each view there is, in all 19,000 for 20 views). The set has no counterpart in a room; the shared pool is it.
SELECTED_VIEWS = NativeSettings(goal_keyframes=True, iterations=100, budget="10 or 20 views out of a data set")
