"""Check that the files of a run agree: counts, lengths of lists, and numbers that are stored twice."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from activestructure_gym.evaluation.archive.decisions import Row
from activestructure_gym.evaluation.archive.picture_record import STORED_VIEWS, pixel_size, plan_scale
from activestructure_gym.evaluation.archive.schema import Mismatch

if TYPE_CHECKING:
    from activestructure_gym.evaluation.protocols import StandardProtocol

Arrays = Mapping[str, np.ndarray]


def check_counts(
    results: Mapping[str, Any], decisions: Sequence[float], steps: Sequence[Mapping[str, Any]], trajectory: Arrays
) -> None:
    """Raise `Mismatch` unless ``metrics.json``, ``timing.json``, the steps and the trajectory agree.

    ``results`` is the content of ``metrics.json``. ``decisions`` holds the elapsed seconds at the end of each decision.
    """
    metrics, curve = results["metrics"], results["curve"]
    count = len(steps)
    _agree("decisions", {"metrics.json": metrics.get("decisions"), "steps.jsonl": count, "timing.json": len(decisions),
                         "the legs of trajectory.npz": len(trajectory["legs"]) if "legs" in trajectory else None,
                         "the curve of metrics.json": curve[-1]["decision"]})  # fmt: skip
    last: Mapping[str, Any] = steps[-1] if steps else {}
    for name in ("frames", "metres"):
        at_the_end = {"metrics.json": metrics[name], "its curve": curve[-1][name], "steps.jsonl": last.get(name)}
        _agree(name, at_the_end)
    _agree("Gaussians", {"metrics.json": metrics.get("gaussians"), "steps.jsonl": last.get("gaussians")})
    _agree("keyframes", {"metrics.json": metrics.get("keyframes"), "trajectory.npz": len(trajectory["keyframes"])})
    if count and "legs" in trajectory:
        poses, frames, _ = (int(value) for value in trajectory["legs"][-1])
        _agree("poses", {"the legs of trajectory.npz": poses, "its path": len(trajectory["world_from_camera"])})
        _agree("frames", {"the legs of trajectory.npz": frames, "metrics.json": metrics["frames"]})
    _check_curve(curve, steps)


def _check_curve(curve: Sequence[Mapping[str, Any]], steps: Sequence[Mapping[str, Any]]) -> None:
    """Raise `Mismatch` unless every point of the curve except the first equals the checkpoint of its step."""
    taken = [(number, step) for number, step in enumerate(steps, start=1) if step.get("checkpoint") is not None]
    if not taken:  # an episode without a decision
        return
    _agree("points of the curve", {"metrics.json": len(curve), "steps.jsonl": 1 + len(taken)})
    for (number, step), point in zip(taken, curve[1:]):
        stored = {"decision": number, "frames": step["frames"], "metres": step.get("metres"), **step["checkpoint"]}
        for name, value in stored.items():
            _agree(f"{name} after decision {number}", {"steps.jsonl": value, "the curve": point.get(name)})


def check_views(results: Mapping[str, Any], protocol: StandardProtocol, pictures: Arrays) -> None:
    """Raise `Mismatch` unless the pictures show the first measured views in the protocol's image size."""
    measured = results["metrics"]["views"]
    if results["metrics"]["true_samples"] is None:  # without ground truth: pictures of keyframes
        _check_plan(pictures)
        return
    if not 1 <= len(measured) <= protocol.views:
        raise Mismatch(f"metrics.json lists {len(measured)} views, but its protocol has 1 to {protocol.views}")
    rows, columns = pictures["true"].shape[1:3]
    if protocol.view_source == "free_space" and (rows, columns) != (protocol.view_height, protocol.view_width):
        wanted = f"{protocol.view_width} x {protocol.view_height}"
        raise Mismatch(f"pictures.npz holds views of {columns} x {rows} pixels, but its protocol has {wanted}")
    kept = {"metrics.json": min(STORED_VIEWS, len(measured)), "pictures.npz": len(pictures["psnr"])}
    _agree("pictures of views", kept)
    for number, (view, psnr) in enumerate(zip(measured, pictures["psnr"]), start=1):
        _agree(f"PSNR of view {number}", {"metrics.json": view.get("psnr"), "pictures.npz": float(psnr)})
    _check_plan(pictures)


def _check_plan(pictures: Arrays) -> None:
    """Raise `Mismatch` unless the map from above has the size of the plan."""
    width, height = pixel_size(pictures["plan_extent"], plan_scale(pictures["plan_extent"]))
    if pictures["above_rgb"].shape[:2] != (height, width):
        rows, columns = pictures["above_rgb"].shape[:2]
        raise Mismatch(f"above_rgb of pictures.npz has {columns} x {rows} pixels, and its plan {width} x {height}")


def check_planes(graph: Arrays, steps: Sequence[Mapping[str, Any]]) -> None:
    """Raise `Mismatch` unless the counts in ``graph.npz`` equal those logged at the last step."""
    last: Mapping[str, Any] = steps[-1] if steps else {}
    summary = last.get("graph") or {}
    _agree("planes", {"graph.npz": len(graph["ids"]), "steps.jsonl": last.get("planes")})
    structural = {"graph.npz": int(graph["structural"].sum()), "steps.jsonl": summary.get("structural")}
    _agree("structural planes", structural)
    _agree("holes", {"graph.npz": len(graph["deficiency_areas"]), "steps.jsonl": summary.get("deficiency_centres")})


def check_choices(decisions: Sequence[Sequence[Row]], steps: Sequence[Mapping[str, Any]]) -> None:
    """Raise `Mismatch` unless ``decisions.npz`` begins each decision with the row that ``steps.jsonl`` logs."""
    _agree("decisions", {"decisions.npz": len(decisions), "steps.jsonl": len(steps)})
    for number, (rows, step) in enumerate(zip(decisions, steps)):
        chosen = {"decisions.npz": rows[0].row, "steps.jsonl": step.get("action")}
        _agree(f"row of decision {number}", chosen)


def _agree(what: str, stored: Mapping[str, float | None]) -> None:
    """Raise `Mismatch` unless all files that store a quantity have the same value for it.

    ``what`` names the quantity. ``stored`` maps the description of each file to its value, or to None if the file does
    not store the quantity.
    """
    given = {place: value for place, value in stored.items() if value is not None}
    if len(set(given.values())) > 1:
        (first, one), (second, other) = next(
            (a, b) for a in given.items() for b in given.items() if a[1] != b[1]
        )  # fmt: skip
        raise Mismatch(f"{what}: {one:.10g} by {first}, {other:.10g} by {second}")
