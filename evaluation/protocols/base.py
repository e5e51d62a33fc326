"""Define the interface of protocols: hold constants, compute the reference data of a scene, measure a finished map."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.ground_truth.observable import VIEW_RANGE

if TYPE_CHECKING:
    from activestructure_gym.ground_truth import GroundTruth
    from activestructure_gym.mapping import GaussianMap


@dataclass(frozen=True)
class CameraPath:
    """Hold the camera and the poses of an episode; a protocol reads only these and the map."""

    camera: PinholeCamera
    start: np.ndarray  # [4, 4] world_from_camera of the first frame
    keyframes: np.ndarray  # [K, 4, 4] world_from_camera of the keyframes
    max_range: float = VIEW_RANGE  # maximum depth that the camera measures, metres
    frames: np.ndarray | None = None  # [F, 4, 4] world_from_camera of all frames; None: the keyframes alone are known

    @property
    def all_poses(self) -> np.ndarray:  # [F, 4, 4]
        """Return the poses of all frames, or of the keyframes if no others are known."""
        return self.keyframes if self.frames is None else self.frames

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, np.ndarray]) -> CameraPath:
        """Create the path from the arrays of a ``trajectory.npz``, which `run_files.check_trajectory` has checked."""
        poses = arrays["world_from_camera"]
        width, height = (int(side) for side in arrays["image_size"])
        return cls(
            camera=PinholeCamera(width, height, *(float(value) for value in arrays["intrinsics"])),
            start=poses[0],
            keyframes=poses[arrays["keyframes"]],
            max_range=float(arrays.get("max_range", VIEW_RANGE)),
            frames=poses,
        )


class EvaluationProtocol(Protocol):
    """Define the interface of a protocol, a frozen dataclass whose fields are its constants."""

    @property
    def name(self) -> str:
        """Return the name, which every result file contains."""

    @property
    def version(self) -> int:
        """Return the version, which increases when the same map would get other numbers."""

    def parameters(self) -> dict[str, Any]:
        """Return name, version and all constants for the result file."""

    def truth(self, known: GroundTruth) -> Any:
        """Return the reference data of the scene with the ground truth ``known``, cached by the scene's content."""

    def evaluate(self, gaussians: GaussianMap, truth: Any, path: CameraPath | None = None) -> dict[str, Any]:
        """Return all metrics of a finished map by name.

        ``truth`` is the result of the method `truth`, and ``path`` holds the poses of the episode, if there are any. An
        undefined metric is None, and the entry ``notes`` has the reason.
        """


def measure_by(
    protocol: EvaluationProtocol, gaussians: GaussianMap, truth: Any, path: CameraPath | None
) -> dict[str, Any]:
    """Return the metrics of a map by a protocol, with the entries that stored results have.

    A protocol without images has no ``views`` and no ``lpips``, and one without undefined metrics no ``notes``.
    """
    metrics = protocol.evaluate(gaussians, truth, path)
    absent: dict[str, Any] = {"views": [], "lpips": None, "notes": {}}
    return metrics | {name: value for name, value in absent.items() if name not in metrics}
