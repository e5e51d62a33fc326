"""Numbers from what lies on disk alone: a run's directory, or a map file of any origin."""

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
from activestructure_gym.evaluation.archive.schema import Mismatch
from activestructure_gym.evaluation.archive.store import CONFIG, Run, plain
from activestructure_gym.evaluation.protocols import CameraPath, EvaluationProtocol, get_protocol, protocol_from
from activestructure_gym.npz import read_npz


def protocols_of(run: Run, names: Sequence[str] = ()) -> list[tuple[EvaluationProtocol, dict[str, Any] | None]]:
    """The protocols called ``names``, with the numbers the run stored for each; all that it stored if none is named.

    A stored protocol comes with the constants it was measured with, another one with its usual ones and None.
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
    """The protocol's numbers from ``map.npz`` and ``trajectory.npz`` alone, in JSON's types."""
    from activestructure_gym.evaluation.running.recorded_scene import load_job_scene
    from activestructure_gym.ground_truth import ground_truth_of

    # Nobody plays here: of what the job names only the scene is loaded.
    refuse_code([replace(run.job, policy="random", conditions=Conditions())], run.directory / CONFIG)
    path, gaussians = CameraPath.from_arrays(run.trajectory), run.gaussians
    return plain(protocol.evaluate(gaussians, protocol.truth(ground_truth_of(load_job_scene(run.job))), path))


def differing(stored: dict[str, Any], numbers: dict[str, Any]) -> list[str]:
    """Names of the numbers that are not the stored ones to the last bit.

    LPIPS is compared only where both have it: it depends on weights that need not be here today.
    """
    partial = stored.get("lpips") is None or numbers.get("lpips") is None
    if partial:
        stored, numbers = without_lpips(stored), without_lpips(numbers)
    return [name for name, value in numbers.items() if name not in stored or stored[name] != value]


def without_lpips(numbers: dict[str, Any]) -> dict[str, Any]:
    """Return the numbers without LPIPS, of every view too."""
    kept = {name: value for name, value in numbers.items() if not name.startswith("lpips")}
    kept["views"] = [{k: v for k, v in view.items() if k != "lpips"} for view in numbers["views"]]
    kept["notes"] = {k: v for k, v in numbers["notes"].items() if k != "lpips"}
    return kept


def measure_file(
    map_file: str | Path, scene: str, protocol: EvaluationProtocol, *, poses: str | None = None
) -> dict[str, Any]:
    """A protocol's numbers of a map of any origin: our ``map.npz``, SplaTAM's ``params.npz``, or a 3DGS PLY.

    A PLY must lie in the scene's frame (z up, metres); a ``params.npz`` lies in its first camera's, which is the first
    of ``poses``, a ``trajectory.npz``. What needs poses is None without them. Raises `InputError`.
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
    return plain(protocol.evaluate(gaussians, protocol.truth(ground_truth_of(load_scene(scene))), path))


def _refuse_turned(map_file: str | Path) -> None:
    """Raise `InputError` for a PLY that says, as `asg export --up` writes it, that it is not z up."""
    with suppress(OSError), open(map_file, "rb") as file:
        said = re.match(rb"ply\r?\n(?:[^\n]*\n){1,9}?comment world frame, (-?[xy]) up", file.read(1000))
        if said:
            raise InputError(
                f"'{map_file}' says that {said[1].decode()} is up in it, and a map is measured z up, as its scene: "
                "export it with --up z, or give the run itself"
            )


def read_path(file: str | Path) -> CameraPath:
    """The poses and the camera of a ``trajectory.npz``; raises `InputError` if it is none."""
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
            f"'{file}' holds no camera's path: {error}; expected are the arrays world_from_camera [T, 4, 4], "
            "keyframes [K], intrinsics [4] and image_size [2]"
        ) from error
    return CameraPath.from_arrays(arrays)


def _as_stored(name: str, array: np.ndarray) -> np.ndarray:
    """A path from elsewhere may have numbers of another width, such as float32."""
    wanted = run_files.TRAJECTORY.get(name)
    same_kind = wanted is not None and array.dtype.kind in ("f" if wanted.dtype == "f8" else "iu")
    return array.astype(wanted.dtype) if wanted is not None and same_kind else array
