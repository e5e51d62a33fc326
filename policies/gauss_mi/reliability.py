"""Reliability of every Gaussian from each side: GauSS-MI's log-odds, updated by one vote per keyframe.

GauSS-MI gives a Gaussian one log-odds of being right for each of the four horizontal directions
it may be looked at in. A keyframe speaks for the direction it looked in: where the map shows what was seen, the
log-odds rise, where it shows something else, they fall.

- loss of a pixel: L = .95 mean |I - C| + .05 |D - depth|, without the depth where none was measured;
- its vote: -log max(1.7 L, 1e-4), positive below a loss of .59;
- a Gaussian's vote: 10 times the sum of vote times weight over the pixels in which the transmittance in front of it is
  above .8, times the share of the direction; none where these pixels are too few.

The constants are those of images of 640 x 480: the factor 10 and the number of pixels are scaled by the image's size.

Source: [gauss_mi, code].
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from activestructure_gym.features.rows_by_id import RowsById
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.mapping.frustum_culling import MapParts
from activestructure_gym.mapping.gaussian_map import GaussianMap
from activestructure_gym.splatting import Rendering
from activestructure_gym.splatting.fisher import view_information
from activestructure_gym.splatting.rasterizers import rasterizer

COLOR_SHARE, DEPTH_SHARE = 0.95, 0.05  # of the loss; colours 0..1, depth in metres
LOSS_FACTOR, MIN_LOSS = 1.7, 1e-4
VOTE_FACTOR = 10.0
CLEAR = 0.8  # transmittance in front, above which a pixel counts
MIN_PIXELS = 5
OF_PIXELS = 640 * 480
LIMIT = 10.0  # of the log-odds


class DirectionalReliability:
    """Log-odds of every Gaussian for the directions +x, +y, -x, -y; 0, that is one half, for new ones."""

    def __init__(self, gaussians: GaussianMap, backend: str = "cpu") -> None:
        self._map, self._backend = gaussians, backend
        self._log_odds = RowsById(gaussians, 4)
        self._known = 0  # keyframes that have voted

    def update(self, keyframes: Sequence[Frame]) -> np.ndarray:  # [N, 4] float64, a view until the next call
        """Let the keyframes vote that have not yet; each votes once, with the map as it is at that moment."""
        if len(keyframes) < self._known:
            raise ValueError(f"expected the {self._known} keyframes of the last call and more, got {len(keyframes)}")
        log_odds = self._log_odds.follow()
        for frame in keyframes[self._known :]:
            self._vote(frame, log_odds)
        self._known = len(keyframes)
        return log_odds

    def _vote(self, frame: Frame, log_odds: np.ndarray) -> None:
        gaussians, camera, pose = self._map, frame.camera, frame.world_from_camera
        unseen = MapParts(gaussians).unseen(camera, pose)
        shown = rasterizer(self._backend).render(gaussians.parameters, gaussians.count, camera, pose, unseen=unseen)
        (seen,) = view_information(
            gaussians.parameters, gaussians.count, camera, pose,
            pixel_values=pixel_votes(frame, shown), touch_transmittance=CLEAR, unseen=unseen,
        )  # fmt: skip
        scale = OF_PIXELS / (camera.width * camera.height)
        vote = VOTE_FACTOR * scale * np.where(seen.touches * scale >= MIN_PIXELS, seen.gathered, 0.0)
        shares = direction_shares(gaussians.parameters[:3, seen.indices].T, pose[:3, 3])
        votes = np.clip(vote[:, None] * shares, -LIMIT, LIMIT)
        log_odds[seen.indices] = np.clip(log_odds[seen.indices] + votes, -LIMIT, LIMIT)


def pixel_votes(frame: Frame, shown: Rendering) -> np.ndarray:  # [H, W] float32
    """-log of the loss, above 0 where the map shows what the keyframe saw; its depth is that over alpha."""
    loss = COLOR_SHARE * np.abs(shown.color - frame.rgb * np.float32(1.0 / 255.0)).mean(axis=2)
    depth = shown.depth / np.maximum(shown.alpha, 1e-6)
    loss += DEPTH_SHARE * np.where(frame.depth > 0, np.abs(depth - frame.depth), 0.0)
    return -np.log(np.maximum(LOSS_FACTOR * loss, MIN_LOSS)).astype(np.float32)


def direction_shares(
    means: np.ndarray,  # [S, 3] metres, world
    eye: np.ndarray,  # [3] metres, world
) -> np.ndarray:  # [S, 4] in 0..1
    """Parts along +x, +y, -x, -y of the unit vectors from the eye to the means; the vertical part is left out."""
    ray = means - eye
    ray = ray / np.maximum(np.linalg.norm(ray, axis=1, keepdims=True), 1e-9)
    return np.concatenate([np.maximum(ray[:, :2], 0.0), np.maximum(-ray[:, :2], 0.0)], axis=1)
