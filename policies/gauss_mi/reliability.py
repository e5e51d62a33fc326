"""Estimate the reliability of every Gaussian from each side: GauSS-MI's log-odds, updated by the votes of keyframes.

A Gaussian has one log-odds of being correct for each of four horizontal view directions. A keyframe votes for its own
view direction. The log-odds increase if the rendered map agrees with the keyframe, and decrease otherwise:

- The loss of a pixel is L = 0.95 mean |I - C| + 0.05 |D - depth|. The map is rendered over a white background, and its
  depth is the accumulated one: a hole counts as an error. The loss is 0 without a measured depth. Black pixels, with a
  sum of the channels up to 0.01, have no colour term.
- The vote of a pixel is -log max(1.7 L, 1e-4), which is positive for a loss below 0.59.
- The vote for a Gaussian is 10 times the sum of vote times weight over pixels, times the share of the direction. Pixels
  count if the transmittance in front of the Gaussian exceeds 0.8. There is no vote if too few pixels count.

The constants are for images of 640 x 480. The factor 10 and the number of pixels are scaled by the image size.

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

COLOR_SHARE, DEPTH_SHARE = 0.95, 0.05  # weights in the loss; colours in 0..1, depth in metres
LOSS_FACTOR, MIN_LOSS = 1.7, 1e-4
BLACK = 0.01  # largest sum of the three channels (0..1) of a pixel without a colour term
VOTE_FACTOR = 10.0
CLEAR = 0.8  # a pixel counts if the transmittance in front of the Gaussian exceeds this
MIN_PIXELS = 5  # minimum number of pixels for a vote, in an image of OF_PIXELS
OF_PIXELS = 640 * 480
LIMIT = 10.0  # largest absolute value of a vote
MAX_LOG_ODDS = float(np.log(9999.0))  # probabilities stay between 0.0001 and 0.9999 after each vote


class DirectionalReliability:
    """Hold the log-odds that each Gaussian is correct from the directions +x, +y, -x, -y.

    The log-odds of new Gaussians are 0, which is a probability of 0.5.
    """

    def __init__(self, gaussians: GaussianMap, backend: str = "cpu") -> None:
        """Store the map, which mapping changes in place, and the name of the rasteriser's backend."""
        self._map, self._backend = gaussians, backend
        self._log_odds = RowsById(gaussians, 4)
        self._known = 0  # keyframes that have voted

    def update(self, keyframes: Sequence[Frame]) -> np.ndarray:  # [N, 4] float64, a view until the next call
        """Add the votes of the keyframes that are new since the last call, with the current map; return the log-odds.

        ``keyframes`` are all keyframes, those of the last call first.
        """
        if len(keyframes) < self._known:
            raise ValueError(
                f"expected all keyframes, at least the {self._known} of the last call, got {len(keyframes)}"
            )
        log_odds = self._log_odds.follow()
        for frame in keyframes[self._known :]:
            self._vote(frame, log_odds)
        self._known = len(keyframes)
        return log_odds

    def _vote(self, frame: Frame, log_odds: np.ndarray) -> None:
        """Add the votes of a keyframe for the Gaussians that it sees to the log-odds [N, 4], in place."""
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
        log_odds[seen.indices] = np.clip(log_odds[seen.indices] + votes, -MAX_LOG_ODDS, MAX_LOG_ODDS)


def pixel_votes(frame: Frame, shown: Rendering) -> np.ndarray:  # [H, W] float32
    """Return the vote of each pixel, -log max(1.7 L, 1e-4) with the loss L of the module's docstring.

    It is positive if the rendering ``shown`` of the map agrees with the keyframe ``frame``.
    """
    on_white = shown.color + (1.0 - shown.alpha[..., None])
    true = frame.rgb * np.float32(1.0 / 255.0)
    loss = COLOR_SHARE * np.abs(on_white - true).mean(axis=2) * (true.sum(axis=2) > BLACK)
    loss += DEPTH_SHARE * np.abs(shown.depth - frame.depth)
    loss[frame.depth <= 0] = 0.0
    return -np.log(np.maximum(LOSS_FACTOR * loss, MIN_LOSS)).astype(np.float32)


def direction_shares(
    means: np.ndarray,  # [S, 3] metres, world
    eye: np.ndarray,  # [3] metres, world
) -> np.ndarray:  # [S, 4] in 0..1
    """Return the positive components along +x, +y, -x, -y of the unit vectors from ``eye`` to ``means``."""
    ray = means - eye
    ray = ray / np.maximum(np.linalg.norm(ray, axis=1, keepdims=True), 1e-9)
    return np.concatenate([np.maximum(ray[:, :2], 0.0), np.maximum(-ray[:, :2], 0.0)], axis=1)
