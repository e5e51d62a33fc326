"""Define the observation: its keys, shapes, units and meanings, the space, the table in the docs, and the encoder.

Policies import column names from this module. It imports only numpy and gymnasium until an observation is encoded.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from gymnasium import spaces

from activestructure_gym.errors import InputError, listed, short_repr, unknown_name

if TYPE_CHECKING:
    from activestructure_gym.config import ReconstructionConfig
    from activestructure_gym.reconstruction import Reconstruction
    from activestructure_gym.sensors import Frame

CANDIDATE_COLUMNS = ("x", "y", "z", "look_x", "look_y", "look_z", "path_length", "frames", "revisit")
# Last columns of the table if `ViewConfig.stages` names other sources than the shared pool; see `row_columns`.
STAGE_COLUMNS = ("stay", "fixates", "at_x", "at_y", "at_z")
MAX_DISTANCE_M = 1000.0  # upper bound of positions and lengths (metres), and of the column ``stay`` (rounds)
MAX_FRAMES = 10 * MAX_DISTANCE_M  # upper bound of numbers of frames
MAX_FEATURE = 1e6  # bound of a feature's magnitude
MAX_BYTES = 1 << 27  # of one observation; the space, which also stores both bounds, takes three times as much


def candidate_columns(*names: str) -> list[int]:
    """Return the indices of the named columns (`CANDIDATE_COLUMNS`) of ``observation["candidates"]``."""
    return [CANDIDATE_COLUMNS.index(name) for name in names]


def row_columns(stages: Sequence[Sequence[str]]) -> tuple[str, ...]:
    """Return the column names of ``observation["candidates"]`` for the given stages of candidate sources.

    With the shared pool alone, they are `CANDIDATE_COLUMNS`. Otherwise these columns follow:

    - ``from_<source>``: 1 in the rows of that source.
    - ``ask_<stage>``: 1 in the row that switches to that stage, counted from 0; only with two or more stages.
    - ``stay``: rounds of optimisation in place; 0 for a motion.
    - ``fixates``: 1 if the camera points at a fixed point along the path.
    - ``at_x``, ``at_y``, ``at_z``: that point, in metres.
    """
    if tuple(map(tuple, stages)) == (("pool",),):
        return CANDIDATE_COLUMNS
    sources = tuple(dict.fromkeys(f"from_{name}" for stage in stages for name in stage))
    asks = tuple(f"ask_{stage}" for stage in range(len(stages))) if len(stages) > 1 else ()
    return (*CANDIDATE_COLUMNS, *sources, *asks, *STAGE_COLUMNS)


def feature_columns(*names: str) -> tuple[str, ...]:
    """Return the full names of all columns of the named features; raise `InputError` for an unknown feature."""
    from activestructure_gym.features import column_names  # imported here to keep this module fast to import

    return column_names(names)


def plane_columns(*names: str) -> list[int]:
    """Return the indices of the named columns (``planes.PLANE_FEATURES``) of ``observation["plane_features"]``."""
    from activestructure_gym.planes import PLANE_FEATURES  # imported here to keep this module fast to import

    return [PLANE_FEATURES.index(name) for name in names]


class Table(spaces.Box):
    """Describe a Box with named columns: ``names[i]`` is the name of ``[..., i]``.

    Two tables are equal only if their names are equal. A stored network is therefore not loaded onto an observation
    with other columns. A table and a plain Box are compared without names.
    """

    def __init__(self, names: Sequence[str], low: np.ndarray, high: np.ndarray, dtype: Any = np.float32) -> None:
        """Create the space with one name for each index of the last axis of ``low`` and ``high``."""
        super().__init__(low, high, dtype=dtype)
        self.names = tuple(names)

    def __repr__(self) -> str:
        return f"Table({', '.join(self.names)}: {super().__repr__()})"

    def __eq__(self, other: Any) -> bool:
        return bool(super().__eq__(other)) and getattr(other, "names", self.names) == self.names


def feature_names(source: Any) -> tuple[str, ...]:
    """Return the column names of ``observation["candidate_features"]``, in order.

    ``source`` is an env (wrapped or not), a vector env of Gymnasium or stable-baselines3, an observation space, or the
    names themselves, such as ``info["features"]``. Raises `InputError` if ``source`` does not contain the names.
    """
    if isinstance(source, list | tuple) and all(isinstance(name, str) for name in source):
        return tuple(source)
    space = _space_of(source)
    table = space.spaces.get("candidate_features") if isinstance(space, spaces.Dict) else space
    if isinstance(table, Table):
        return table.names
    if isinstance(space, spaces.Dict) and table is None:
        raise InputError(
            f"observations have {listed(space)}, and no candidate_features: add this key, or leave out observation_keys"
        )
    if isinstance(table, spaces.Space):
        raise InputError(
            "this observation space has no names for the columns of candidate_features, perhaps because of a wrapper; "
            "give the list of names, info['features']"
        )
    raise InputError(
        "the names of the feature columns come from an env, from its observation space or from a list of names as in "
        f"info['features'], got {short_repr(source)}"
    )


def row_names(source: Any) -> tuple[str, ...]:
    """Return the column names of ``observation["candidates"]``; `CANDIDATE_COLUMNS` if ``source`` has no names."""
    space = _space_of(source)
    table = space.spaces.get("candidates") if isinstance(space, spaces.Dict) else None
    return table.names if isinstance(table, Table) else CANDIDATE_COLUMNS


def _space_of(source: Any) -> Any:
    """Return the observation space of an env or of a single env of a vector env; other objects unchanged."""
    return getattr(source, "single_observation_space", getattr(source, "observation_space", source))


@dataclass(frozen=True)
class Key:
    """Define one entry of the observation."""

    shape: tuple[int, ...]
    dtype: Any
    low: Any  # lower bound: a scalar, or an array that broadcasts to the shape
    high: Any  # upper bound, as ``low``
    unit: str
    meaning: str
    names: tuple[str, ...] | None = None  # column names, for a table whose columns are different quantities

    @property
    def size(self) -> int:
        """Return the bytes of one array, as a Python integer, which cannot overflow."""
        return math.prod(int(length) for length in self.shape) * np.dtype(self.dtype).itemsize

    def space(self) -> spaces.Box:
        """Return the Box of this entry, a `Table` if its columns have names."""
        low = np.broadcast_to(np.asarray(self.low, self.dtype), self.shape)
        high = np.broadcast_to(np.asarray(self.high, self.dtype), self.shape)
        if self.names is not None:
            return Table(self.names, low.copy(), high.copy(), self.dtype)
        return spaces.Box(low.copy(), high.copy(), self.shape, self.dtype)


def observation_keys(config: ReconstructionConfig, max_planes: int) -> dict[str, Key]:
    """Return all entries for a configuration: K candidates, G feature columns, P planes, F plane features."""
    from activestructure_gym.planes import PLANE_FEATURE_HIGH, PLANE_FEATURE_LOW, PLANE_FEATURES

    height, width = config.sensor.height, config.sensor.width
    K, G, P, F = config.views.max_candidates, len(config.features), max_planes, len(PLANE_FEATURES)
    far = MAX_DISTANCE_M
    columns = row_columns(config.views.stages)
    known = dict.fromkeys(("x", "y", "z", "at_x", "at_y", "at_z"), (-far, far))
    known |= dict.fromkeys(("look_x", "look_y", "look_z"), (-1.0, 1.0))
    known |= {"path_length": (0.0, far), "frames": (0.0, MAX_FRAMES), "stay": (0.0, far)}
    bounds = np.array([known.get(name, (0.0, 1.0)) for name in columns], np.float32)
    f32, u8, i8 = np.float32, np.uint8, np.int8
    return {
        "rgb": Key((height, width, 3), u8, 0, 255, "sRGB", "colour image of the last keyframe"),
        "depth": Key(
            (height, width),
            f32,
            0,
            config.sensor.max_range,
            "m",
            "its depth along the optical axis; 0 = not measured, or no surface within range",
        ),
        "pose": Key((7,), f32, [-far] * 3 + [-1] * 4, [far] * 3 + [1] * 4, "m, -", "world_from_camera: position, wxyz"),
        "budget": Key((1,), f32, 0, 1, "share", "frames left of the budget"),
        "candidates": Key(
            (K, len(columns)),
            f32,
            bounds[:, 0],
            bounds[:, 1],
            "m",
            ", ".join(columns),
            columns,
        ),
        "candidate_features": Key(
            (K, G),
            f32,
            -MAX_FEATURE,
            MAX_FEATURE,
            "-",
            "the requested features, one or more columns each",
            config.features,
        ),
        "action_mask": Key((K,), i8, 0, 1, "-", "1 where the row holds a candidate"),
        "fidelity": Key(
            (2,), f32, 0, 200, "dB", "PSNR of the keyframes when last rendered: lowest tenth (10 % quantile), median"
        ),
        "plane_features": Key(
            (P, F), f32, PLANE_FEATURE_LOW, PLANE_FEATURE_HIGH, "-", "PLANE_FEATURES of the nodes", PLANE_FEATURES
        ),
        "plane_mask": Key((P,), i8, 0, 1, "-", "1 where the row holds a plane"),
        "plane_edges": Key((P, P), f32, 0, 1, "-", "edge weight w_ij (Eq. 4), small = reliable; 0 = no edge"),
        "plane_tree": Key((P, P), i8, 0, 1, "-", "1 where the edge is in the minimum spanning forest"),
        "candidate_planes": Key((K, P), i8, 0, 1, "-", "1 where the candidate would see the plane"),
    }


def observation_space(
    config: ReconstructionConfig, max_planes: int, chosen: Sequence[str] | None = None
) -> spaces.Dict:
    """Return the observation space: a flat Dict of fixed-size arrays, as stable-baselines3 requires.

    It has the entries ``chosen``, by default all. Raises `InputError` for an unknown entry, an empty list, and if one
    observation would take more than `MAX_BYTES`.
    """
    keys = observation_keys(config, max_planes)
    if chosen is not None:
        if isinstance(chosen, str) or not isinstance(chosen, Sequence) or not len(chosen):
            raise InputError(f"observation_keys must be a list of one or more names, got {short_repr(chosen)}")
        for name in chosen:
            if name not in keys:
                raise unknown_name("entry of the observation", name, keys)
        keys = {name: key for name, key in keys.items() if name in chosen}
    if sum(key.size for key in keys.values()) > MAX_BYTES:
        raise InputError(
            f"one observation would take more than {MAX_BYTES >> 20} MiB with views.max_candidates "
            f"{short_repr(config.views.max_candidates)}, max_planes {short_repr(max_planes)}, sensor.width "
            f"{short_repr(config.sensor.width)} and sensor.height {short_repr(config.sensor.height)}; lower "
            "the largest of them"
        )
    return spaces.Dict({name: key.space() for name, key in keys.items()})


def observation_table(config: ReconstructionConfig, max_planes: int) -> str:
    """Return the Markdown table of all entries for the docs."""
    rows = ["| key | shape | dtype | unit | meaning |", "|---|---|---|---|---|"]
    for name, key in observation_keys(config, max_planes).items():
        rows.append(f"| `{name}` | {key.shape} | {np.dtype(key.dtype).name} | {key.unit} | {key.meaning} |")
    return "\n".join(rows)


def _quantile(values: np.ndarray, share: float) -> float:
    """Return exactly `numpy.quantile` of one or more finite numbers, in a tenth of the time."""
    ordered = np.sort(values).tolist()
    at = share * (len(ordered) - 1)
    low = int(at)
    first, second, rest = ordered[low], ordered[min(low + 1, len(ordered) - 1)], at - low
    step = second - first
    return float(first + step * rest if rest < 0.5 else second - step * (1.0 - rest))


_VIEW_LIMITS = np.array([MAX_DISTANCE_M] * 3 + [1.0] * 3)
_POSE_LIMITS = np.array([MAX_DISTANCE_M] * 3 + [1.0] * 4)


def _limited(values: np.ndarray, limit: np.ndarray | float) -> np.ndarray:
    """Return the values limited to -limit .. limit, in a third of the time of `numpy.clip`."""
    return np.minimum(np.maximum(values, -limit), limit)


def encode(reconstruction: Reconstruction, frame: Frame, max_planes: int) -> dict[str, np.ndarray]:
    """Return the observation of the current state. Every array is new and shared with no other observation."""
    from activestructure_gym.geometry.rotations import quaternions  # imported here to keep this module fast to import
    from activestructure_gym.motion import least_frames

    config, table = reconstruction.config, reconstruction.candidates
    size, count = config.views.max_candidates, len(table)
    columns = row_columns(config.views.stages)
    candidates = np.zeros((size, len(columns)), np.float32)
    views = np.concatenate([table.world_from_camera[:, :3, 3], table.world_from_camera[:, :3, 2]], axis=1)
    candidates[:count, :6] = _limited(views, _VIEW_LIMITS)
    candidates[:count, 6] = np.minimum(table.path_length, MAX_DISTANCE_M)
    frames = least_frames(reconstruction.pose, table.world_from_camera, table.path_length, config.motion)
    candidates[:count, 7] = np.minimum(frames, MAX_FRAMES)
    candidates[:count, 8] = table.revisit
    if columns != CANDIDATE_COLUMNS:
        _fill_stage_columns(candidates[:count], columns, reconstruction)
    features = np.zeros((size, len(config.features)), np.float32)
    features[:count] = _limited(reconstruction.features, MAX_FEATURE)
    mask = np.zeros(size, np.int8)
    mask[:count] = 1

    graph = reconstruction.planes
    planes = graph.arrays(max_planes)
    seen = np.zeros((size, max_planes), np.int8)
    seen[:count, : len(planes.nodes)] = reconstruction.visible[:, planes.nodes]

    fidelity = reconstruction.mapper.keyframe_psnr(renders=0)
    quaternion = quaternions(frame.world_from_camera[None, :3, :3], canonical=True)[0]
    pose = np.concatenate([frame.world_from_camera[:3, 3], quaternion])
    left = max(0, config.frame_budget - reconstruction.frames) / config.frame_budget
    return {
        "rgb": frame.rgb.copy(),
        "depth": frame.depth.copy(),
        "pose": _limited(pose, _POSE_LIMITS).astype(np.float32),
        "budget": np.array([left], np.float32),
        "candidates": candidates,
        "candidate_features": features,
        "action_mask": mask,
        "fidelity": np.clip([_quantile(fidelity, 0.1), _quantile(fidelity, 0.5)], 0.0, 200.0).astype(np.float32),
        "plane_features": planes.features,
        "plane_mask": planes.mask,
        "plane_edges": planes.edge_weights,
        "plane_tree": planes.tree,
        "candidate_planes": seen,
    }


def _fill_stage_columns(rows: np.ndarray, columns: tuple[str, ...], reconstruction: Reconstruction) -> None:
    """Fill the columns that exist with other candidate sources than the shared pool, and correct ``frames``."""
    table, config = reconstruction.candidates, reconstruction.config
    at = {name: index for index, name in enumerate(columns)}
    for index, column in enumerate(name for name in columns if name.startswith("from_")):
        rows[:, at[column]] = (table.source == index) & (table.ask < 0)
    for stage in range(len(config.views.stages)):
        if f"ask_{stage}" in at:
            rows[:, at[f"ask_{stage}"]] = table.ask == stage
    fixates = ~np.isnan(table.look_at).any(axis=1)
    rows[:, at["stay"]] = np.minimum(table.stay, MAX_DISTANCE_M)
    rows[:, at["fixates"]] = fixates
    rows[:, at["at_x"] : at["at_z"] + 1] = np.where(
        fixates[:, None], np.clip(np.nan_to_num(table.look_at), -MAX_DISTANCE_M, MAX_DISTANCE_M), 0.0
    )
    # Frames of rows that are no motion: optimisation in place, and stage switches, which are free.
    frames = np.minimum(table.stay * config.keyframe_every, MAX_FRAMES)
    rows[table.stay > 0, at["frames"]] = frames[table.stay > 0]
    rows[table.ask >= 0, at["frames"]] = 0.0
    # Ending the episode costs all remaining frames, so that a policy with a travel cost does not score it as near.
    rows[table.ends, at["frames"]] = min(max(0, config.frame_budget - reconstruction.frames), MAX_FRAMES)
