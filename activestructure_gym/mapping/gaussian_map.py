"""Define the map of 3D Gaussians: a growing array of coloured ellipsoids and their Adam moments."""

from __future__ import annotations

import os

import numpy as np

from activestructure_gym.errors import InputError
from activestructure_gym.files import replaced
from activestructure_gym.mapping.boxes import BLOCK, renew_boxes
from activestructure_gym.npz import read_npz
from activestructure_gym.splatting.workspace import aligned_zeros

# Rows of the parameter array. Each quantity has its own row (structure of arrays), so that kernels load 16 Gaussians at
# once.
MEAN = slice(0, 3)  # metres, world
QUATERNION = slice(3, 7)  # wxyz, not necessarily of unit length
LOG_SCALE = slice(7, 10)  # natural logarithm of the standard deviation in metres, along the axes of the ellipsoid
OPACITY_LOGIT = 10  # logit of the opacity at the centre
COLOR = slice(11, 14)  # RGB, about 0..1, not clamped
ROWS = 14  # number of parameters per Gaussian

_LANES = 16  # vector width of the kernels; the capacity is a multiple of it
_CHUNK = 1024  # Gaussians per chunk of the rasteriser
MAX_LOG_SCALE = 40.0  # the square of a larger scale is beyond float32
_FORMAT_VERSION = 1  # version of the npz format
_MAX_BYTES = 3 * ROWS * 4 * 100_000_000  # largest accepted npz file: parameters and moments of 100 million Gaussians


def usable(parameters: np.ndarray) -> np.ndarray:  # [14, N] float32 -> [N] bool
    """Return which Gaussians of a file can be rendered: all parameters are finite, and so are their squared scales."""
    return np.isfinite(parameters).all(axis=0) & (parameters[LOG_SCALE] <= MAX_LOG_SCALE).all(axis=0)


class GaussianMap:
    """Hold Gaussians and their Adam moments.

    ``parameters``, ``first_moment`` and ``second_moment`` are arrays [14, capacity] float32. Their first ``count``
    columns are in use; the values of the others are undefined. Kernels read and write these arrays in place. ``ids``
    [capacity] int64 identifies every Gaussian: its column can change, its id cannot. Code that changes means or scales
    in ``parameters`` must call `touched`, since `boxes` computes only the boxes of changed blocks.

    Parameters
    ----------
    capacity : int
        Number of Gaussians that fit before the arrays are enlarged.

    Examples
    --------
    >>> gaussians = GaussianMap()
    >>> gaussians.append(np.zeros((14, 3), np.float32))  # rows: mean, quaternion, log-scale, opacity logit, colour
    >>> gaussians.means.shape, gaussians.opacities.tolist()
    ((3, 3), [0.5, 0.5, 0.5])
    """

    def __init__(self, capacity: int = 4096) -> None:
        self.parameters = _empty_rows(_rounded_up(capacity))
        self.first_moment = _empty_rows(_rounded_up(capacity))
        self.second_moment = _empty_rows(_rounded_up(capacity))
        self.ids = np.zeros(_rounded_up(capacity), dtype=np.int64)
        self._boxes, self._stale = _empty_boxes(_rounded_up(capacity))
        self.next_id = 0  # number of Gaussians added so far, the next id
        self.count = 0

    def __len__(self) -> int:
        return self.count

    @property
    def capacity(self) -> int:
        """Return the number of Gaussians that fit before the arrays are enlarged."""
        return self.parameters.shape[1]

    @property
    def means(self) -> np.ndarray:  # [N, 3] metres, world
        """Return a copy of the means."""
        return self.parameters[MEAN, : self.count].T.copy()

    @property
    def quaternions(self) -> np.ndarray:  # [N, 4] wxyz, unit
        """Return the orientations as unit quaternions; a zero quaternion becomes the identity."""
        raw = self.parameters[QUATERNION, : self.count].T
        length = np.linalg.norm(raw, axis=1, keepdims=True)
        identity = np.array([1.0, 0.0, 0.0, 0.0], dtype=np.float32)
        return np.where(length > 0, raw / np.maximum(length, 1e-30), identity)

    @property
    def scales(self) -> np.ndarray:  # [N, 3] metres
        """Return the standard deviations along the axes given by `quaternions`."""
        return np.exp(self.parameters[LOG_SCALE, : self.count].T)

    @property
    def opacities(self) -> np.ndarray:  # [N] 0..1
        """Return the opacities at the centres."""
        return _sigmoid(self.parameters[OPACITY_LOGIT, : self.count])

    @property
    def colors(self) -> np.ndarray:  # [N, 3]
        """Return a copy of the RGB colours; clip to 0..1 for display."""
        return self.parameters[COLOR, : self.count].T.copy()

    def append(self, block: np.ndarray) -> None:
        """Append Gaussians ``block`` [14, n] with zero Adam moments; raise `ValueError` for another shape."""
        block = np.asarray(block)
        if block.ndim != 2 or block.shape[0] != ROWS:
            raise ValueError(f"a block of Gaussians has the shape (14, n), got {block.shape}")
        start, stop = self.count, self.count + block.shape[1]
        if stop > self.capacity:
            # The capacity grows by half: the copying cost per Gaussian is constant, and less memory is unused than with
            # doubling.
            self._resize(_rounded_up(max(stop, self.capacity + self.capacity // 2)))
        self.parameters[:, start:stop] = block
        self.first_moment[:, start:stop] = 0.0
        self.second_moment[:, start:stop] = 0.0
        self.ids[start:stop] = np.arange(self.next_id, self.next_id + stop - start)
        self._stale[start // BLOCK : -(-stop // BLOCK)] = True
        self.next_id += stop - start
        self.count = stop

    def keep(self, mask: np.ndarray) -> int:
        """Remove the Gaussians whose entry in ``mask`` ([count] bool) is False; return the number removed."""
        mask = np.asarray(mask)
        if mask.dtype != bool or mask.shape != (self.count,):
            raise ValueError(f"mask must be bool of shape ({self.count},), got {mask.dtype} of shape {mask.shape}")
        return self.remove(np.flatnonzero(~mask))

    def remove(self, columns: np.ndarray) -> int:
        """Remove the Gaussians in ``columns`` ([n] int, increasing); return the number removed.

        The last remaining columns move into the gaps, with their moments and ids; the others keep their columns. The
        cost is proportional to the number removed and not to the size of the map. Raises `ValueError` for invalid
        columns.
        """
        columns = np.asarray(columns)
        if len(columns) and not (columns[0] >= 0 and columns[-1] < self.count and (np.diff(columns) > 0).all()):
            raise ValueError(f"columns must rise within 0..{self.count - 1}, got {columns}")
        removed = len(columns)
        kept = self.count - removed
        if removed:
            gaps = columns[columns < kept]
            movers = np.setdiff1d(np.arange(kept, self.count), columns, assume_unique=True)
            for array in (self.parameters, self.first_moment, self.second_moment):
                array[:, gaps] = array[:, movers]
            self.ids[gaps] = self.ids[movers]
            self._stale[gaps // BLOCK] = True
            self._stale[kept // BLOCK] = True  # the last block is shorter now
            self.count = kept
        return removed

    def reorder(self, order: np.ndarray) -> None:
        """Sort the Gaussians, their moments and ids by ``order`` ([count] indices, each once)."""
        order = np.asarray(order)
        if order.shape != (self.count,) or not np.array_equal(np.sort(order), np.arange(self.count)):
            raise ValueError(
                f"order must hold each index from 0 to {self.count - 1} once, "
                f"got {order.dtype} of the shape {order.shape}"
            )
        for array in (self.parameters, self.first_moment, self.second_moment):
            for row in array:
                row[: self.count] = row[order]
        self.ids[: self.count] = self.ids[order]
        self.touched()

    def touched(self, chunks: np.ndarray | None = None) -> None:
        """Mark chunks of 1024 Gaussians in which means or scales were changed.

        ``chunks`` [chunks] bool, None means all.
        """
        if chunks is None:
            self._stale[:] = True
        else:
            self._stale.reshape(-1, _CHUNK // BLOCK)[: len(chunks)] |= chunks[:, None]

    def boxes(self) -> np.ndarray:  # [B, 7] float64, see `block_boxes`; read-only
        """Return the bounding boxes of all blocks of 256 Gaussians.

        Only blocks changed since the last call are computed.
        """
        blocks = -(-self.count // BLOCK)
        renew_boxes(self.parameters, self.count, np.flatnonzero(self._stale[:blocks]), self._boxes)
        self._stale[:blocks] = False
        return self._boxes[:blocks]

    def reset_moments(self) -> None:
        """Set all Adam moments to 0."""
        self.first_moment[:, : self.count] = 0.0
        self.second_moment[:, : self.count] = 0.0

    def _resize(self, capacity: int) -> None:
        for name in ("parameters", "first_moment", "second_moment"):
            old = getattr(self, name)
            new = _empty_rows(capacity)
            new[:, : self.count] = old[:, : self.count]
            setattr(self, name, new)
        ids = np.zeros(capacity, dtype=np.int64)
        ids[: self.count] = self.ids[: self.count]
        self.ids = ids
        boxes, stale = _empty_boxes(capacity)
        boxes[: len(self._boxes)], stale[: len(self._stale)] = self._boxes, self._stale
        self._boxes, self._stale = boxes, stale

    def save_npz(self, path: str | os.PathLike[str]) -> None:
        """Write parameters and Adam moments to a file, so that mapping can continue from it.

        An existing file is replaced only when the new one is complete.
        """
        with replaced(path) as file:
            np.savez(
                file,
                format_version=np.int64(_FORMAT_VERSION),
                parameters=self.parameters[:, : self.count],
                first_moment=self.first_moment[:, : self.count],
                second_moment=self.second_moment[:, : self.count],
            )

    @classmethod
    def load_npz(cls, path: str | os.PathLike[str]) -> GaussianMap:
        """Read a map written by `save_npz`; raise `InputError` for any other file. Pickled objects are never loaded."""
        try:
            content = read_npz(path, _MAX_BYTES)
        except FileNotFoundError:
            raise InputError(f"expected a saved Gaussian map, but there is no file '{path}'") from None
        except (OSError, ValueError) as error:
            raise InputError(f"'{path}' is not a Gaussian map saved as npz ({error})") from error
        version = content.get("format_version")
        if version is None or version.shape != () or version.dtype != np.int64 or version != _FORMAT_VERSION:
            raise InputError(
                f"'{path}' has the map format {version}, this version reads format {_FORMAT_VERSION}; "
                "save the map again or export it as PLY"
            )
        names = ("parameters", "first_moment", "second_moment")
        blocks = [content.get(name) for name in names]
        shapes = [None if block is None else block.shape for block in blocks]
        if shapes[0] is None or len(set(shapes)) > 1 or len(shapes[0]) != 2 or shapes[0][0] != ROWS:
            raise InputError(f"'{path}' should hold three arrays of one shape (14, n), but their shapes are {shapes}")
        types = [content[name].dtype for name in names]
        if any(dtype != np.float32 for dtype in types):
            raise InputError(f"'{path}' should hold three arrays of float32, but their types are {types}")
        parameters, first, second = (content[name] for name in names)
        if not all(np.isfinite(block).all() for block in (parameters, first, second)):
            raise InputError(f"'{path}' holds Gaussians with values that are not finite")
        loaded = cls(shapes[0][1])
        loaded.append(parameters)
        loaded.first_moment[:, : loaded.count], loaded.second_moment[:, : loaded.count] = first, second
        return loaded


def learning_rates(
    *, mean: float, quaternion: float, log_scale: float, opacity: float, color: float
) -> np.ndarray:  # [14] float32
    """Return the learning rate of every row of the map's parameters, from one rate per quantity."""
    rates = np.zeros(ROWS, dtype=np.float32)
    rates[MEAN], rates[QUATERNION], rates[LOG_SCALE] = mean, quaternion, log_scale
    rates[OPACITY_LOGIT], rates[COLOR] = opacity, color
    return rates


def _empty_rows(capacity: int) -> np.ndarray:  # [14, capacity] float32 zeros
    # The capacity is a multiple of 16, so every row begins on a cache line.
    return aligned_zeros(ROWS * capacity).reshape(ROWS, capacity)


def _empty_boxes(capacity: int) -> tuple[np.ndarray, np.ndarray]:  # [B, 7] float64, [B] bool: outdated
    # There is one chunk more than a full map has, since `remove` can mark the block behind the last Gaussian.
    blocks = (capacity // _CHUNK + 1) * (_CHUNK // BLOCK)
    return np.empty((blocks, 7)), np.ones(blocks, dtype=bool)


def _rounded_up(capacity: int) -> int:
    return max(_LANES, -(-capacity // _LANES) * _LANES)


def _sigmoid(x: np.ndarray) -> np.ndarray:
    # The form with tanh does not overflow for any finite logit.
    return 0.5 * (1.0 + np.tanh(0.5 * x))
