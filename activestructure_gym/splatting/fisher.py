"""Compute the Fisher information of a view about each Gaussian, together with weights and pixel counts, without torch.

The information about a Gaussian is a block: the sum over pixels and colour channels of J^T J. J is the derivative of a
rendered colour by the Gaussian's mean (metres, world) and log-scales. Information-based planners compare it between a
candidate and the keyframes ([fisherrf]; [popgs] suggests geometry; omitting the rotation is our choice).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.splatting import layout
from activestructure_gym.splatting.arguments import Pictures
from activestructure_gym.splatting.cpu import check_map
from activestructure_gym.splatting.simd import LANES
from activestructure_gym.splatting.workspace import MAX_ALPHA, PooledWorkspace, Workspace, fitted, flat, inverse_of_pose

TOUCH_TRANSMITTANCE = 0.5  # transmittance limit of `ViewInformation.touches`; published programs use 0.5 or 0.8
BLOCK_NUMBERS = 21  # numbers in the upper triangle of a symmetric 6 x 6 matrix
DIAGONAL = np.array([0, 6, 11, 15, 18, 20])  # diagonal in `ViewInformation.blocks`: mean x, y, z, log-scale 0, 1, 2
_NO_FLOATS = np.empty(0, np.float32)


@dataclass(frozen=True)
class ViewInformation:
    """Hold the images of one camera, and its information about each of the S Gaussians that contribute to an image."""

    color: np.ndarray  # [H, W, 3] float32
    depth: np.ndarray  # [H, W] float32 accumulated depth: sum of weight times depth, metres
    alpha: np.ndarray  # [H, W] float32 0..1
    channels: np.ndarray  # [H, W, D] float32: sum of weight times channel
    indices: np.ndarray  # [S] int64, increasing: columns of the Gaussians in the parameters
    numbers: np.ndarray  # [S, 26] float32 all numbers per Gaussian; the properties below are views of it

    @property
    def blocks(self) -> np.ndarray:  # [S, 21]
        """Return the upper triangles, row by row, of the 6 x 6 blocks for mean (3) and log-scales (3).

        See `full_blocks`.
        """
        return self.numbers[:, :BLOCK_NUMBERS]

    @property
    def logits(self) -> np.ndarray:  # [S]
        """Return the information about each opacity logit, a diagonal entry without cross terms."""
        return self.numbers[:, 21]

    @property
    def colors(self) -> np.ndarray:  # [S]
        """Return the information about each colour channel: the sum of squared weights, equal for all three."""
        return self.numbers[:, 22]

    @property
    def weights(self) -> np.ndarray:  # [S] > 0
        """Return the sum over the pixels of each Gaussian's weight: alpha times the transmittance in front of it."""
        return self.numbers[:, 23]

    @property
    def touches(self) -> np.ndarray:  # [S]
        """Return each Gaussian's number of pixels in which the transmittance in front of it is above a limit."""
        return self.numbers[:, 24]

    @property
    def gathered(self) -> np.ndarray:  # [S]
        """Return the sum of weight times pixel value over the pixels of `touches`; 0 without pixel values."""
        return self.numbers[:, 25]


def view_information(
    parameters: np.ndarray,  # [14, capacity] float32, rows as in `cpu`
    count: int,  # number of Gaussians N
    camera: PinholeCamera,
    world_from_camera: np.ndarray,  # [4, 4] or [C, 4, 4]
    *,
    channels: np.ndarray | None = None,  # [N, D] values of the Gaussians, blended to images
    pixel_values: np.ndarray | None = None,  # [H, W] values of the pixels, summed per Gaussian
    touch_transmittance: float = TOUCH_TRANSMITTANCE,
    max_alpha: float = MAX_ALPHA,
    threads: int | None = None,
    unseen: np.ndarray | None = None,  # [chunks] bool, as in `cpu.render`
) -> Iterator[ViewInformation]:
    """Yield one `ViewInformation` per camera, computed when it is requested, to save memory.

    Results are bit-equal for any number of threads. Source: [fisherrf] in its exact form: channels are squared before
    they are summed, while its program sums them first. Raises `ValueError` for arrays of another shape or type.
    """
    check_map(parameters, count)
    poses = np.asarray(world_from_camera, dtype=np.float64).reshape(-1, 4, 4)
    if channels is None:
        channels = np.empty((count, 0), np.float32)
    if channels.ndim != 2 or len(channels) != count:
        raise ValueError(f"channels must have the shape [{count}, D], got {channels.shape}")
    if pixel_values is not None and pixel_values.shape != (camera.height, camera.width):
        raise ValueError(f"pixel_values must have the shape {camera.height, camera.width}, got {pixel_values.shape}")
    values = _NO_FLOATS if pixel_values is None else flat(pixel_values)
    given = (fitted(parameters), count, camera)
    options = {"max_alpha": max_alpha, "threads": threads, "unseen": unseen}
    own, touch = flat(channels), np.float32(touch_transmittance)
    return (_of_view(given, pose, own, values, touch, options) for pose in poses)


def depth_information(
    parameters: np.ndarray,  # [14, capacity] float32, rows as in `cpu`
    count: int,  # number of Gaussians
    camera: PinholeCamera,
    world_from_camera: np.ndarray,  # [4, 4]
    *,
    unseen: np.ndarray | None = None,  # [chunks] bool, as in `cpu.render`
) -> ViewInformation:
    """Return the information of one camera for accumulated depth (sum of weight times depth) instead of colours.

    The depth of each Gaussian is rendered as its colour, which is exact for log-scales and opacity. A mean also changes
    its own depth: the block gets the sum of squared weights times z z^T, with z the derivative of the depth by the
    mean. The product of both effects is left out, since its sums are not stored. For Gaussians entirely inside the
    image it almost cancels, since its sign is that of the offset from the mean. Only ``blocks`` and ``logits`` are
    meaningful; there are no channels. Source: [next_best_sense], J^T J of the rendered depth.
    """
    # Optical axis of the camera, the derivative of the depth by the mean.
    axis = np.asarray(world_from_camera, dtype=np.float64)[:3, 2]
    depths = axis @ (parameters[:3, :count] - np.asarray(world_from_camera)[:3, 3:])
    painted = fitted(parameters).copy()
    painted[11:] = 0.0
    painted[11, :count] = depths
    (seen,) = view_information(painted, count, camera, world_from_camera, unseen=unseen)
    row, column = np.triu_indices(6)
    own = np.flatnonzero((row < 3) & (column < 3))
    seen.blocks[:, own] += seen.colors[:, None] * (axis[row[own]] * axis[column[own]]).astype(np.float32)
    return seen


def _of_view(given, pose, channels, values, touch, options) -> ViewInformation:  # type: ignore[no-untyped-def]
    parameters, count, camera = given
    pooled = PooledWorkspace()
    workspace = pooled.workspace
    workspace.prepare(parameters, count, camera, inverse_of_pose(pose), **options)
    width = len(channels) // max(1, count)
    pictures = np.empty((camera.height, camera.width, width), np.float32)
    indices, numbers = _run(workspace, channels, values, touch, pictures)
    return ViewInformation(*workspace.pictures(), pictures, indices, numbers)


def _run(
    workspace: Workspace, channels: np.ndarray, values: np.ndarray, touch: np.float32, pictures: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:  # indices [S], numbers [S, 26]
    """Compute the information and the images on a prepared workspace, which then holds the images.

    ``channels`` and ``values`` are flat, see `view_information`; ``touch`` is the transmittance limit. The images of
    the channels are written to ``pictures`` [H, W, D].
    """
    from activestructure_gym.splatting import fisher_kernels as f

    camera, grid = workspace.camera, workspace.grid
    capacity, count = int(grid[layout.CAPACITY]), int(grid[layout.COUNT])
    pixels = camera.width * camera.height
    workspace.depth, workspace.alpha = workspace._buffer("depth", pixels), workspace._buffer("alpha", pixels)
    workspace.color = workspace._image("color")
    slots = workspace._buffer("information slots", workspace.total * f.SLOT_FLOATS)
    result = workspace._buffer("information", capacity * f.RESULT_FLOATS)
    asked = f.Asked(touch, pictures.shape[2], channels, values)
    workspace._run_through(
        f.inform, workspace.parameters, workspace.lists, workspace._scratch, asked,
        Pictures(workspace.color, workspace.depth, workspace.alpha), f.Told(pictures.reshape(-1), slots, result),
    )  # fmt: skip
    taken = workspace.lists.taken
    words = workspace.visible[: (taken[-1] + 1) * (layout.CHUNK // LANES)].reshape(-1, layout.CHUNK // LANES)
    bits = np.unpackbits(words[taken].astype("<u2").view(np.uint8), axis=1, bitorder="little")
    chunk, place = np.nonzero(bits)
    indices = taken[chunk] * layout.CHUNK + place
    indices = indices[indices < count]  # the other bits are from an earlier image
    rows = result[: capacity * f.RESULT_FLOATS].reshape(capacity, f.RESULT_FLOATS)
    # Whole rows are copied, because copying 26 of 32 numbers takes longer.
    return indices, np.take(rows, indices, axis=0, mode="clip")[:, : f.COLUMNS]


def full_blocks(blocks: np.ndarray) -> np.ndarray:  # [..., 21] -> [..., 6, 6]
    """Return the symmetric 6 x 6 matrices of upper triangles, see `ViewInformation.blocks`."""
    full = np.empty((*blocks.shape[:-1], 6, 6), blocks.dtype)
    row, column = np.triu_indices(6)
    full[..., row, column] = blocks
    full[..., column, row] = blocks
    return full
