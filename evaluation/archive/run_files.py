"""Define the checks of every file of a comparison and of a run; `store` lists the files."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.archive.json_files import json_text
from activestructure_gym.evaluation.archive.schema import (
    Array,
    Check,
    Mismatch,
    anything,
    check_arrays,
    checked_json,
    each,
    maybe,
    number,
    scalar,
    table,
    text,
)
from activestructure_gym.evaluation.metrics.planning import CURVE_MEASURES, LATE, LEVELS
from activestructure_gym.evaluation.protocols.metrics import Metric
from activestructure_gym.evaluation.protocols.metrics.standard import STANDARD, SURFACE
from activestructure_gym.ranges import MAX_ASPECT_RATIO, MAX_COORDINATE_M, MAX_FRAMES
from activestructure_gym.specs import Spec

_MAX_IMAGE_SIDE = 16384  # pixels
_MAX_PICTURES = 64
_MAX_PLANES, _MAX_MARKS = 100_000, 5_000_000
_RIGID = 1e-3  # largest deviation of an entry of R R^T from the identity
_UNIT = 1e-2  # largest deviation of a normal's length from 1

_count = number(0, whole=True)
_size = number(0)
_numbers = table(others=maybe(number()))

PROTOCOL: Check = table({"name": text, "version": number(whole=True)})
JOB: Check = table(
    {
        "scene": text, "policy": text, "seed": number(0, 2**63 - 1, whole=True), "scene_hash": text, "preset": text,
        "frame_budget": maybe(number(1, whole=True)), "overrides": table(),
        "start_pose": maybe(each(number(-MAX_COORDINATE_M, MAX_COORDINATE_M), length=4)), "protocol": PROTOCOL,
        "also": each(table({"name": text}, {"version": number(whole=True)})),
    },
    {"setup": text, "metrics": each(text), "swept": table()},
)  # fmt: skip
COMPARISON: Check = table(
    {"jobs": table(others=JOB)},
    {
        "format": number(whole=True), "command": text, "resumed": each(text), "engine": text,
        "workers": maybe(_count), "failed": table(others=text), "attempts": table(others=_count),
        "versions": table(others=text), "hardware": table(others=scalar),
    },
)  # fmt: skip
CONFIG: Check = table(
    {
        "format": number(whole=True),
        "job": JOB,
        "scene": table({
            "source": text, "notes": each(text), "triangles": _count, "extent_m": each(_size, length=3),
        }, {"name": text, "spec": text, "content_hash": text}),
        "configuration": table({
            "frame_budget": number(1, whole=True),
            "sensor": table({
                "width": number(1, _MAX_IMAGE_SIDE, whole=True), "height": number(1, _MAX_IMAGE_SIDE, whole=True),
                "depth_noise": anything,
            }),
        }, {
            "motion": table({}, {"max_step_m": _size, "max_turn_deg": _size, "candidate_clearance": _size}),
            "views": table({}, {"max_candidates": number(1, whole=True), "stages": each(each(text), least=1)}),
            "mapper": table({}, {"name": text, "iterations": _count}), "features": each(text),
            "keyframe_every": number(1, whole=True),
        }),
        "versions": table(dict.fromkeys(("activestructure-gym", "python", "numpy", "numba"), text),
                          others=text),
    },
    {"hash": text, "own_code": table(others=text)},
)  # fmt: skip

_MEASURED = (
    *(metric.name for metric in STANDARD), *(f"tsdf_{metric.name}" for metric in SURFACE), "observed_area",
    *LATE.values(),
)  # fmt: skip
_SIZES = ("keyframes", "gaussians")  # of a run, and of a map that a further protocol trains
# Metrics of runs that follow a given trajectory; those of the second line only with a reference trajectory.
_FOLLOWED = (
    "largest_step_m", "largest_turn_deg", "steps_too_long", "turns_too_wide", "poses_outside",
    "ate_m", "rpe_m", "rpe_deg", "poses_matched", "align_scale",
)  # fmt: skip
_VIEWS = {"views": each(_numbers), "notes": table(others=text)}
_POINT = {"decision": _count, "frames": _size, "metres": _size, "completion_ratio": maybe(number())}
_POINT_MORE = {name: maybe(number()) for name in CURVE_MEASURES if name not in _POINT}
CURVE: Check = each(table(_POINT, _POINT_MORE), least=1)
_OWN_METRIC = table(
    {"name": text, "label": text, "unit": text, "digits": number(0, 12, whole=True), "best": text, "meaning": text},
    {"reason": text},
)
METRICS: Check = table(
    {
        "format": number(whole=True),
        "metrics": table(
            {
                **_VIEWS, "completion_ratio": maybe(number()), "psnr": maybe(number()), "lpips": maybe(number()),
                "frames": _count, "metres": _size, "collisions": maybe(_count), "true_area_m2": maybe(_size),
                "true_samples": maybe(_count),
            },
            dict.fromkeys((*_MEASURED, "decisions", "invalid_actions", *_SIZES), maybe(number()))
            | {f"frames_to_{level}": maybe(_size) for level in LEVELS}
            | dict.fromkeys(_FOLLOWED, _size)
            | {"planning_notes": table(others=text)},
        ),
        "curve": CURVE,
    },
    {"protocol": PROTOCOL, "scene": text, "own_metrics": each(_OWN_METRIC)},
)  # fmt: skip
_TRUTH = table({
    "completion_ratio": number(), "psnr": number(), "collisions": _count, "true_area_m2": _size, "true_samples": _count,
})  # fmt: skip
EVALUATION: Check = table(
    {
        "protocol": PROTOCOL,
        "metrics": table(
            {**_VIEWS, "lpips": maybe(number())},
            dict.fromkeys((*_MEASURED, *_SIZES), maybe(number())),
        ),
    }
)
TIMING: Check = table(
    {
        "total": _size, "seconds": table(others=_size), "decisions": each(_size),
        "hardware": table({"processor": scalar, "cores": scalar}, others=scalar),
    }
)  # fmt: skip
_TRACE: Check = table(
    {},
    {
        "phase": maybe(text), "changed": maybe(text), "chosen": maybe(table(others=scalar)),
        "runner_up": maybe(table({}, {"total": maybe(number())})),
    },
)  # fmt: skip
STEP: Check = table(
    {"frames": _size},
    {
        "decision": _count, "action": number(whole=True), "candidates": _count, "metres": _size, "gaussians": _count,
        "planes": _count, "view": maybe(table(others=number())), "features": maybe(_numbers), "trace": maybe(_TRACE),
        "graph": maybe(_numbers), "checkpoint": maybe(_numbers),
    },
)  # fmt: skip


def _places(*shape: int | str, least: int = 0) -> Array:
    """Return the `Array` of world positions in metres."""
    return Array("f8", shape, low=-MAX_COORDINATE_M, high=MAX_COORDINATE_M, least=least)


TRAJECTORY = {
    "world_from_camera": _places("T", 4, 4, least=1),
    "keyframes": Array("i8", ("K",), low=0, least=1),
    "intrinsics": Array("f8", (4,)),
    "image_size": Array("i8", (2,), low=1, high=_MAX_IMAGE_SIDE),
}
_LEGS = {"keyframe_rounds": Array("i8", ("K",), low=0, high=1000), "legs": Array("i8", ("D", 3), low=0)}
_RANGE = {"max_range": Array("f8", (), low=0, high=MAX_COORDINATE_M)}  # of the sensor, metres; optional
_PLAN = {
    "plan_state": Array("u1", ("columns", "rows"), high=2, least=1),
    "plan_corner": _places(2),
    "plan_extent": Array("f8", (2,), low=1e-3, high=MAX_COORDINATE_M),
    "above_rgb": Array("u1", ("h", "w", 3), high=255, least=1),
    "above_alpha": Array("u1", ("h", "w"), high=255, least=1),
}
_PICTURES = {
    "rendered": Array("u1", ("views", "height", "width", 3), high=255, least=1),
    "true": Array("u1", ("views", "height", "width", 3), high=255, least=1),
    "psnr": Array("f8", ("views",), least=1),
} | _PLAN
_GRAPH = {
    "ids": Array("i8", ("planes",)),
    "normals": Array("f8", ("planes", 3), low=-2, high=2),
    "offsets": Array("f8", ("planes",)),
    "centroids": _places("planes", 3),
    "areas": Array("f8", ("planes",), low=0),
    "structural": Array("b1", ("planes",)),
    "deficit": Array("f8", ("planes",)),
    "edges": Array("i8", ("edges", 2), low=0),
    "edge_weights": Array("f8", ("edges",)),
    "edge_in_tree": Array("b1", ("edges",)),
    "deficiency_centres": _places("holes", 3),
    "deficiency_normals": Array("f8", ("holes", 3)),
    "deficiency_areas": Array("f8", ("holes",), low=0),
    "deficiency_planes": Array("i8", ("holes",), low=0),
    "cell": Array("f8", (), low=1e-4, high=1e3),
    "patch_corners": _places("planes", 3),
    "patch_axes": Array("f8", ("planes", 2, 3), low=-2, high=2),
    "patch_shapes": Array("i8", ("planes", 2), low=0, high=1e6),
    "patch_starts": Array("i8", ("starts",), low=0),
    "patch_bits": Array("u1", ("bytes",), high=255),
}


def check_trajectory(arrays: Mapping[str, np.ndarray]) -> None:
    """Raise `Mismatch` unless poses are rigid, keyframes index them, and the camera is plausible."""
    legs = _LEGS if _LEGS.keys() & arrays.keys() else {}  # absent from trajectories of other programs
    sizes = check_arrays(arrays, TRAJECTORY | (_RANGE if "max_range" in arrays else {}) | legs)
    if sizes["T"] > MAX_FRAMES:
        raise Mismatch(f"it holds {sizes['T']} poses, at most {MAX_FRAMES} are read")
    poses = arrays["world_from_camera"]
    rotations = poses[:, :3, :3]
    off = np.abs(rotations @ rotations.transpose(0, 2, 1) - np.eye(3)).max()
    if off > _RIGID or np.abs(poses[:, 3] - [0, 0, 0, 1]).max() > _RIGID:
        raise Mismatch("world_from_camera holds matrices that are not rigid poses")
    if int(arrays["keyframes"].max()) >= sizes["T"]:
        raise Mismatch(f"keyframes holds an index beyond the {sizes['T']} poses")
    if not (arrays["intrinsics"][:2] > 1e-3).all():
        raise Mismatch("intrinsics: focal lengths must be above 0")
    width, height = (int(side) for side in arrays["image_size"])
    if max(width, height) > MAX_ASPECT_RATIO * min(width, height):
        raise Mismatch(f"image_size: {width} x {height} pixels are not a plausible image size")


def check_pictures(arrays: Mapping[str, np.ndarray]) -> None:
    """Raise `Mismatch` unless all views have one size and the plan's arrays agree."""
    sizes = check_arrays(arrays, _PICTURES)
    if sizes["views"] > _MAX_PICTURES:
        raise Mismatch(f"it holds {sizes['views']} views, at most {_MAX_PICTURES} are read")
    _check_cells(arrays)


def check_plan(arrays: Mapping[str, np.ndarray]) -> None:
    """Raise `Mismatch` unless the plan's arrays agree."""
    check_arrays(arrays, _PLAN)
    _check_cells(arrays)


def _check_cells(arrays: Mapping[str, np.ndarray]) -> None:
    cells = arrays["plan_extent"] / arrays["plan_state"].shape  # metres
    if abs(cells[0] - cells[1]) > 1e-6 * cells.max():
        raise Mismatch("plan_state and plan_extent do not fit together: its cells are not square")


def check_graph(arrays: Mapping[str, np.ndarray]) -> None:
    """Raise `Mismatch` unless indices of planes exist, normals are unit vectors, and patches fit their bits."""
    sizes = check_arrays(arrays, _GRAPH)
    planes = sizes["planes"]
    if planes > _MAX_PLANES or sizes["edges"] + sizes["holes"] > _MAX_MARKS:
        raise Mismatch(f"it holds {planes} planes, {sizes['edges']} edges and {sizes['holes']} holes: too many to draw")
    for name in ("edges", "deficiency_planes"):
        if arrays[name].size and int(arrays[name].max()) >= planes:
            raise Mismatch(f"{name} holds an index beyond the {planes} planes")
    if planes and np.abs(np.linalg.norm(arrays["normals"], axis=1) - 1.0).max() > _UNIT:
        raise Mismatch("normals are not of length 1")
    starts, shapes = arrays["patch_starts"].astype(np.int64), arrays["patch_shapes"].astype(np.int64)
    packed = -(-shapes.prod(axis=1) // 8)
    if len(starts) != planes + 1 or starts[0] != 0 or (np.diff(starts) != packed).any() or starts[-1] != sizes["bytes"]:
        raise Mismatch("patch_starts, patch_shapes and patch_bits do not fit together")


# Configuration fields that native settings change, in addition to those in `NativeSettings.changes`.
NATIVE_FIELDS = (
    "mapper.name", "mapper.iterations", "views.stages", "views.max_candidates", "keyframe_every",
    "motion.candidate_clearance",
)  # fmt: skip
_FOLLOWING = ("mapper.name",)  # fields that a report needs of runs that follow a trajectory


def check_config(content: Any, place: str) -> None:
    """Raise `Mismatch` unless ``config.json`` has all fields that its setup and its policy require."""
    CONFIG(content, place)
    job, configuration = content["job"], content["configuration"]
    wanted: tuple[str, ...] = NATIVE_FIELDS if job.get("setup") == "native" else ()
    wanted += _FOLLOWING if Spec(job["policy"]).kind == "trajectory" else ()
    for field in wanted:
        room, _, name = field.rpartition(".")
        if name not in (configuration.get(room, {}) if room else configuration):
            raise Mismatch(f"configuration lacks {field}")


def check_metrics(content: Any, place: str) -> None:
    """Raise `Mismatch` unless ``metrics.json`` is valid, and every metric that it describes is a number or null.

    Only a run without ground truth, which has no ``true_samples``, may lack the numbers that need it.
    """
    METRICS(content, place)
    if content["metrics"]["true_samples"] is not None:
        _TRUTH(content["metrics"], "metrics")
        for index, point in enumerate(content["curve"]):
            number()(point["completion_ratio"], f"curve[{index}].completion_ratio")
    for described in content.get("own_metrics", ()):
        metric = Metric.from_dict(described)
        maybe(number())(content["metrics"].get(metric.name), f"metrics.{metric.name}")


def check_steps(steps: list[Any]) -> None:
    """Raise `Mismatch` unless every decision is valid and the frames never decrease."""
    if len(steps) > MAX_FRAMES:
        raise Mismatch(f"it holds {len(steps)} decisions, at most {MAX_FRAMES} are read")
    for number_, step in enumerate(steps, start=1):
        STEP(step, f"line {number_}")
    frames = [step["frames"] for step in steps]
    if any(later < earlier for earlier, later in zip(frames, frames[1:])):
        raise Mismatch("frames decrease from one line to the next")


def trace_as_read(policy: str, trace: Any) -> dict[str, Any]:
    """Return the trace of a policy as it is read from a run; raise `InputError` if it cannot be written or read.

    ``policy`` names the policy in the message.
    """
    try:
        return dict(checked_json(json_text(trace).encode(), _TRACE))
    except (TypeError, RecursionError, Mismatch) as error:
        raise InputError(f"{policy}: trace() must return a dictionary that JSON can hold: {error}") from error


__all__ = [
    "COMPARISON",
    "CONFIG",
    "CURVE",
    "EVALUATION",
    "JOB",
    "NATIVE_FIELDS",
    "TIMING",
    "TRAJECTORY",
    "anything",
    "check_config",
    "check_graph",
    "check_metrics",
    "check_pictures",
    "check_plan",
    "check_steps",
    "check_trajectory",
    "trace_as_read",
]
