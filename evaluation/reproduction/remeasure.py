"""Measure stored maps: the map in a run's directory, or a map file of any origin."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.archive import run_files
from activestructure_gym.evaluation.archive.conditions import Conditions
from activestructure_gym.evaluation.archive.jobs import refuse_code
from activestructure_gym.evaluation.archive.json_files import plain
from activestructure_gym.evaluation.archive.schema import Mismatch
from activestructure_gym.evaluation.archive.store import CONFIG, Run
from activestructure_gym.evaluation.protocols import CameraPath, EvaluationProtocol, get_protocol, protocol_from
from activestructure_gym.evaluation.protocols.base import measure_by
from activestructure_gym.npz import read_npz
from activestructure_gym.specs import Spec


def protocols_of(run: Run, names: Sequence[str] = ()) -> list[tuple[EvaluationProtocol, dict[str, Any] | None]]:
    """Return the protocols with these ``names``, each with the run's stored metrics; by default all stored protocols.

    A protocol of the run has the recorded constants. Another protocol has its default constants, and None for metrics.
    """
    stored = run.protocols
    for name in names:
        get_protocol(name)
    return [
        (protocol_from(stored[name]["parameters"], run.directory), stored[name]["metrics"])
        if name in stored
        else (get_protocol(name), None)
        for name in names or stored
    ]


def measure_again(run: Run, protocol: EvaluationProtocol) -> dict[str, Any]:
    """Measure the run's ``map.npz`` and ``trajectory.npz`` again, and return the metrics as JSON types."""
    from activestructure_gym.evaluation.running.surroundings import stored_surroundings

    # Only the scene of the job is loaded, so the code of its policy is not needed.
    refuse_code([replace(run.job, policy=Spec("random"), conditions=Conditions())], run.directory / CONFIG)
    path, gaussians = CameraPath.from_arrays(run.trajectory), run.gaussians
    truth = stored_surroundings(run.job, run.directory).truth(protocol)
    if truth is None:
        raise InputError(
            f"'{run.directory}' is a run in a world without ground truth: there is nothing to measure again"
        )
    return plain(measure_by(protocol, gaussians, truth, path))


def differing(stored: dict[str, Any], numbers: dict[str, Any]) -> list[str]:
    """Return the names of the metrics in ``numbers`` that are not bit-identical in ``stored``.

    LPIPS is compared only if both hold it, because its weights may be missing on this machine.
    """
    partial = stored.get("lpips") is None or numbers.get("lpips") is None
    if partial:
        stored, numbers = without_lpips(stored), without_lpips(numbers)
    return [name for name, value in numbers.items() if name not in stored or stored[name] != value]


def without_lpips(numbers: dict[str, Any]) -> dict[str, Any]:
    """Return the metrics of a protocol without LPIPS, also without LPIPS in the entries ``views`` and ``notes``."""
    kept = {name: value for name, value in numbers.items() if not name.startswith("lpips")}
    kept["views"] = [{k: v for k, v in view.items() if k != "lpips"} for view in numbers["views"]]
    kept["notes"] = {k: v for k, v in numbers["notes"].items() if k != "lpips"}
    return kept


def measure_file(
    map_file: str | Path, scene: str, protocol: EvaluationProtocol, *, poses: str | None = None
) -> dict[str, Any]:
    """Measure a map file: ``map.npz`` of a run, ``params.npz`` of SplaTAM, or a PLY of 3D Gaussian splatting.

    A PLY must be in the frame of the scene (z up, metres). A ``params.npz`` is in the frame of its first camera.
    ``poses`` is a ``trajectory.npz`` in the frame of the scene; its first pose places that camera. Without poses the
    metrics that need them are None. Return the metrics as JSON types. Raise `InputError` for an unreadable file.
    """
    from activestructure_gym.ground_truth import ground_truth_of
    from activestructure_gym.mapping.files import map_kind, read_map
    from activestructure_gym.mapping.splatam_file import splatam_path
    from activestructure_gym.scenes import load_scene

    path = read_path(poses) if poses is not None else None
    _refuse_turned(map_file)
    gaussians = read_map(map_file, None if path is None else path.start)
    if path is None and map_kind(map_file) == "splatam":
        arrays = splatam_path(map_file)
        path = _path_of(arrays, map_file) if arrays is not None else None
    return plain(measure_by(protocol, gaussians, protocol.truth(ground_truth_of(load_scene(scene))), path))


def _refuse_turned(map_file: str | Path) -> None:
    """Raise `InputError` if the header of a PLY names x or y as the up axis; a map is measured with z up.

    ``asg export --up`` writes the axis into a comment of the header.
    """
    with suppress(OSError), open(map_file, "rb") as file:
        comment = re.match(rb"ply\r?\n(?:[^\n]*\n){1,9}?comment world frame, (-?[xy]) up", file.read(1000))
        if comment:
            raise InputError(
                f"'{map_file}' has {comment[1].decode()} up, but a map is measured with z up, as its scene: "
                "export it with --up z, or give the run itself"
            )


def read_path(file: str | Path) -> CameraPath:
    """Return the poses and the camera of a ``trajectory.npz``; raise `InputError` if it cannot be read."""
    try:
        return _path_of(read_npz(file), file)
    except InputError:
        raise
    except OSError as error:
        raise InputError(f"'{file}' cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise InputError(f"'{file}' cannot be read as a trajectory.npz: {error}") from error


def _path_of(arrays: Mapping[str, np.ndarray], file: str | Path) -> CameraPath:
    try:
        arrays = {name: _as_stored(name, array) for name, array in arrays.items()}
        run_files.check_trajectory(arrays)
    except Mismatch as error:
        raise InputError(
            f"'{file}' is not a camera trajectory: {error}; expected are the arrays world_from_camera [T, 4, 4], "
            "keyframes [K], intrinsics [4] and image_size [2]"
        ) from error
    return CameraPath.from_arrays(arrays)


def _as_stored(name: str, array: np.ndarray) -> np.ndarray:
    """Convert an array of a trajectory to the type that runs store; other programs may use float32, for example."""
    wanted = run_files.TRAJECTORY.get(name)
    same_kind = wanted is not None and array.dtype.kind in ("f" if wanted.dtype == "f8" else "iu")
    return array.astype(wanted.dtype) if wanted is not None and same_kind else array
