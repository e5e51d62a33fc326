"""The interface of protocols: name the constants, fetch the truth of a scene, measure a finished map."""

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
    """The camera and its poses that a map was made from: all that a protocol reads of an episode besides its map."""

    camera: PinholeCamera
    start: np.ndarray  # [4, 4] world_from_camera of the first frame
    keyframes: np.ndarray  # [K, 4, 4] world_from_camera of those the map was made from
    max_range: float = VIEW_RANGE  # metres along the optical axis that the camera measures

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, np.ndarray]) -> CameraPath:
        """The path in the arrays of ``trajectory.npz``, which `run_files.check_trajectory` has checked."""
        poses = arrays["world_from_camera"]
        width, height = (int(side) for side in arrays["image_size"])
        return cls(
            camera=PinholeCamera(width, height, *(float(value) for value in arrays["intrinsics"])),
            start=poses[0],
            keyframes=poses[arrays["keyframes"]],
            max_range=float(arrays.get("max_range", VIEW_RANGE)),
        )


class EvaluationProtocol(Protocol):
    """A protocol: a frozen dataclass whose fields are all of its constants."""

    @property
    def name(self) -> str:
        """Written into every result file."""

    @property
    def version(self) -> int:
        """Raised whenever the same map would get another number."""

    def parameters(self) -> dict[str, Any]:
        """Name, version and every constant, for the result file."""

    def truth(self, known: GroundTruth) -> Any:
        """The reference data of a scene that maps are compared with (cached by the scene's content)."""

    def evaluate(self, gaussians: GaussianMap, truth: Any, path: CameraPath | None = None) -> dict[str, Any]:
        """All numbers of a finished map; what is not defined is None, and its reason stands under ``notes``."""
