"""Check a policy, feature, candidate source or world of your own, for example in a test.

Each check plays a short episode in a small scene. It raises `AssertionError` with one sentence on the first fault, and
returns the measured time.
"""

from __future__ import annotations

import hashlib
import time
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from activestructure_gym.envs import ReconstructionEnv
from activestructure_gym.envs.inputs import SceneSpec
from activestructure_gym.errors import InputWarning
from activestructure_gym.evaluation.archive.run_files import trace_as_read
from activestructure_gym.features import FEATURES, column_names, evaluate_features
from activestructure_gym.planes.record import graph_arrays
from activestructure_gym.policies import Policy, make_env_and_policy
from activestructure_gym.worlds import (
    World,
    captured,
    checked_bounds,
    checked_pose,
    checked_start,
    frame_from,
    is_world,
    load_world,
)

if TYPE_CHECKING:
    from activestructure_gym.geometry import PinholeCamera
    from activestructure_gym.geometry.frame import Frame
    from activestructure_gym.reconstruction import Reconstruction

_ROWS = 256  # candidates to which times are scaled
_DECISIONS = 4  # of an episode with random choices
_SMALL: dict[str, Any] = {"sensor": {"width": 64, "height": 36}}


@dataclass(frozen=True)
class Checked:
    """Hold what a check measured.

    Attributes
    ----------
    decisions
        Number of decisions that were checked.
    seconds_per_256
        Median seconds for 256 candidates.
    """

    decisions: int
    seconds_per_256: float


def check_policy(policy: str | type[Policy], scene: SceneSpec = "room", *, frames: int = 60) -> Checked:
    """Check that a policy chooses valid rows, equal ones in equal episodes, and changes no observation.

    Parameters
    ----------
    policy
        Name with options, ``package.module:Class``, or a class.
    scene
        Scene of the two episodes.
    frames
        Frame budget of each.

    Returns
    -------
    Checked
        Decisions of an episode, and seconds of ``act`` for 256 candidates.

    Raises
    ------
    AssertionError
        For the first fault.
    InputError
        For a `trace` that a run cannot hold, or native settings that cannot be used.
    """
    chosen, times, made = [], list[float](), None
    for _ in range(2):
        env, fresh = make_env_and_policy(policy, scene, preset="fast", frame_budget=frames, config=_SMALL)
        made = made or fresh  # one object plays both episodes
        made.reset(0)
        observation, _ = env.reset(seed=0)
        rows, ended = list[int](), not observation["action_mask"].any()
        while not ended:
            before = {name: array.copy() for name, array in observation.items()}
            began = time.perf_counter()
            row = made.act(observation)
            times.append((time.perf_counter() - began) * _ROWS / max(int(observation["action_mask"].sum()), 1))
            for name, array in before.items():
                assert np.array_equal(array, observation[name]), f"act() changed observation['{name}']"
            whole = isinstance(row, int | np.integer) and not isinstance(row, bool)
            assert whole, f"act() must return a whole number, got {row!r}"
            valid = 0 <= row < len(observation["action_mask"]) and observation["action_mask"][row]
            assert valid, f"act() returned row {row}, which holds no candidate: observation['action_mask'] is 0 there"
            trace_as_read("the policy", made.trace())
            rows.append(int(row))
            observation, _, terminated, truncated, _ = env.step(row)
            ended = terminated or truncated
        env.close()
        chosen.append(rows)
    assert chosen[0] == chosen[1], (
        f"two episodes with the same seed gave the rows {chosen[0]} and {chosen[1]}: draw random numbers from "
        "self.rng, and keep no state over reset()"
    )
    native, _ = make_env_and_policy(policy, scene, setup="native", preset="fast", frame_budget=frames)
    native.reset(seed=0)
    native.close()
    return Checked(len(chosen[0]), float(np.median(times)))


def check_feature(name: str, scene: SceneSpec = "room") -> Checked:
    """Check that a feature is finite, within its declared bounds, equal when computed again, and changes nothing.

    Parameters
    ----------
    name
        Registered name, or ``package.module:function``.
    scene
        Scene of the episode.

    Returns
    -------
    Checked
        Decisions, and seconds of the feature for 256 candidates.

    Raises
    ------
    AssertionError
        For the first fault.
    InputError
        For an unknown name, or values that are not finite or of the wrong shape.
    """
    feature, columns, times = FEATURES.get(name), column_names((name,)), list[float]()
    decisions = 0
    for env, without in zip(_played(scene, features=(name,)), _played(scene, features=())):
        episode = env.reconstruction
        equal = _digest(episode) == _digest(without.reconstruction)
        assert equal, f"feature '{name}' changed the map, the volume, the planes or the camera's path"
        poses = episode.candidates.world_from_camera[: episode.candidates.views]
        if not len(poses):
            continue
        decisions += 1
        values = [evaluate_features(columns, episode.feature_context(poses)) for _ in range(2)]
        assert np.array_equal(values[0], values[1]), f"feature '{name}' gave other values when it was computed again"
        low, high = (np.asarray(bound, dtype=np.float32) for bound in (feature.low, feature.high))
        outside = (values[0] < low) | (values[0] > high)
        assert not outside.any(), (
            f"feature '{name}' gave {values[0][outside][0]}, outside its declared bounds {feature.low} to "
            f"{feature.high}"
        )
        many = poses[np.arange(_ROWS) % len(poses)]
        context = episode.feature_context(many)
        began = time.perf_counter()
        evaluate_features(columns, context)
        times.append(time.perf_counter() - began)
    return Checked(decisions, float(np.median(times)))


def check_source(name: str, scene: SceneSpec = "room") -> Checked:
    """Check that a candidate source proposes equal, rigid poses in equal episodes, and changes nothing.

    Parameters
    ----------
    name
        Registered name with options, or ``package.module:Class``.
    scene
        Scene of the two episodes.

    Returns
    -------
    Checked
        Decisions, and seconds of the candidate table for 256 rows.

    Raises
    ------
    AssertionError
        For the first fault, also if the source never proposes a reachable view.
    """
    tables, times = [], list[float]()
    for _ in range(2):
        offered = list[np.ndarray]()
        stages = {"views.stages": [[name, "turns"]], "views.max_candidates": 1024}
        for env in _played(scene, config=_SMALL | stages):
            episode = env.reconstruction
            before, began = _digest(episode), time.perf_counter()
            episode._offer()
            times.append((time.perf_counter() - began) * _ROWS / max(len(episode.candidates), 1))
            assert _digest(episode) == before, (
                f"source '{name}' changed the map, the volume, the planes or the camera's path"
            )
            own = episode.candidates.source == 0
            offered.append(episode.candidates.world_from_camera[own].copy())
            for pose in offered[-1]:
                checked_pose(f"a view of source '{name}'", pose)
        tables.append(offered)
    assert any(map(len, tables[0])), f"source '{name}' proposed no view that known free space connects to the camera"
    equal = len(tables[0]) == len(tables[1]) and all(map(np.array_equal, *tables))
    assert equal, f"source '{name}' proposed other views in an equal episode: draw random numbers from context.rng"
    return Checked(len(tables[0]), float(np.median(times)))


def check_world(world: str | World) -> None:
    """Check the members of a world, its frames, and that `close` may be called twice.

    Parameters
    ----------
    world
        A world or its name. A world with a name is made twice, and both must give equal frames.

    Raises
    ------
    AssertionError
        For the first fault.
    InputError
        For bounds, a start, an image or a pose that cannot be used.
    """
    made = load_world(world) if isinstance(world, str) else world
    assert is_world(made), "a world has the members bounds, camera, start, capture and close"
    start, camera = checked_start(made.start, checked_bounds(made.bounds)), made.camera
    for _ in range(2):  # the start can be captured again
        frame = _frame_of(captured(made, start.pose), camera)
        seen = np.isfinite(frame.depth) & (frame.depth > 0)
        assert seen.any(), "the frame at the start has no depth: check its unit (metres) and its pose"
        off = float(np.linalg.norm(frame.world_from_camera[:3, 3] - start.pose[:3, 3]))
        assert off < 0.5, f"the frame at the start was taken {off:.2f} m away from it"
    made.close()
    made.close()
    if isinstance(world, str):
        other = load_world(world)
        again = _frame_of(captured(other, other.start.pose), other.camera)
        other.close()
        assert np.array_equal(again.rgb, frame.rgb) and np.array_equal(again.depth, frame.depth, equal_nan=True), (
            "two fresh worlds of one name gave other frames at the start: take all random numbers from a seed"
        )


def _frame_of(frame: Frame, camera: PinholeCamera) -> Frame:
    """Return a captured frame as an episode takes it."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", InputWarning)
        try:
            return frame_from(frame.rgb, frame.depth, frame.world_from_camera, camera)
        except InputWarning as warning:
            raise AssertionError(str(warning)) from None


def _played(scene: SceneSpec, **options: Any) -> Iterator[ReconstructionEnv]:
    """Yield an environment before each decision of an episode with random choices."""
    options = {"config": _SMALL, **options}
    env, rng = ReconstructionEnv(scene, preset="fast", frame_budget=100, **options), np.random.default_rng(0)
    observation, _ = env.reset(seed=0)
    for _ in range(_DECISIONS):
        yield env
        rows = np.flatnonzero(observation["action_mask"])
        if not len(rows):
            break
        observation, _, terminated, truncated, _ = env.step(rng.choice(rows))
        if terminated or truncated:
            break
    env.close()


def _digest(episode: Reconstruction) -> str:
    """Return a checksum of the map, the volume, the planes and the camera's path."""
    total = hashlib.sha256()
    gaussians = episode.mapper.map
    path = np.array([*episode.trajectory, episode.pose])
    for array in (gaussians.parameters[:, : gaussians.count], episode.volume.state, episode.volume.tsdf, path):
        total.update(np.ascontiguousarray(array).tobytes())
    for array in graph_arrays(episode.planes).values():
        total.update(np.ascontiguousarray(array).tobytes())
    return total.hexdigest()
