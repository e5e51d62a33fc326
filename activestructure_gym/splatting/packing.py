"""Convert between torch tensors with a row per Gaussian and the kernels' array with a row per parameter (`cpu`)."""

# mypy: ignore-errors
# (the arguments of kernels have numba's types)

from __future__ import annotations

import numpy as np
import torch
from numba import njit

from activestructure_gym.compiling import kernel
from activestructure_gym.compiling.thread_team import TEAM
from activestructure_gym.splatting import counters, layout, memory
from activestructure_gym.splatting.simd import LANES

_inline = njit(forceinline=True)
_ROWS = ((0, 3), (3, 7), (7, 10), (10, 11), (11, 14))  # mean, quaternion, log-scale, opacity, colour


def parameter_rows(
    parameters: torch.Tensor,  # [14, N] float32, N a multiple of 16
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    """Return means, quaternions, log-scales, opacity logits and colours that share memory with ``parameters``.

    Shapes: ``[3, N]``, ``[4, N]``, ``[3, N]``, ``[N]``, ``[3, N]``. With gradients (``requires_grad_()``) and passed to
    `rasterize` as ``means.T`` and so on, they are rendered, differentiated and optimised without a copy. Pass these
    whole rows to the optimiser: torch's fused Adam is slow for transposed tensors, and wrong for tensors with gaps
    between rows (torch 2.13).
    """
    means, quaternions, log_scales, logits, colors = (parameters[first:last] for first, last in _ROWS)
    return means, quaternions, log_scales, logits[0], colors


def packed(
    tensors: tuple[torch.Tensor | None, ...],  # means [N, 3] ... colors [N, 3], detached; colours may be None
    threads: int,
) -> np.ndarray:  # [14, capacity]
    """Return one array for the kernels: the memory of the tensors if its layout fits, otherwise a copy."""
    shared = _shared(tensors)
    if shared is not None:
        return shared
    count = len(tensors[0])
    block = np.empty((layout.ROWS, -(-count // LANES) * LANES), np.float32)
    block[:, count:] = 0.0
    columns = [_columns(tensor) for tensor in tensors if tensor is not None]
    TEAM.run(_pack, (np.zeros(1, np.int64), block, *columns, *[columns[0]] * (5 - len(columns))), threads)
    return block


def unpacked(
    gradient: np.ndarray,  # [14, capacity] float32
    tensors: tuple[torch.Tensor | None, ...],  # as in `packed`
    threads: int,
) -> list[torch.Tensor | None]:
    """Return the gradients in the memory layout of the tensors, as torch requires: views of the rows, or copies."""
    count = len(tensors[0])
    rows = torch.from_numpy(gradient)[:, :count]
    results = [rows[first:last].T if last - first > 1 else rows[first] for first, last in _ROWS]
    if all(tensor is None or tensor.is_contiguous() for tensor in tensors):
        results = [torch.empty(result.shape) for result in results]
        TEAM.run(_unpack, (np.zeros(1, np.int64), gradient, *[_columns(result) for result in results]), threads)
    return [None if tensor is None else result for result, tensor in zip(results, tensors)]


def _columns(tensor: torch.Tensor) -> np.ndarray:  # [N, D], contiguous, writeable: one type for numba
    tensor = tensor.contiguous()
    return tensor.numpy().reshape(len(tensor), tensor.shape[1] if tensor.dim() > 1 else 1)


def _shared(tensors: tuple[torch.Tensor | None, ...]) -> np.ndarray | None:
    """Return the array of which the five tensors are columns, or None if they are separate."""
    means = tensors[0]
    if not len(means) or any(tensor is None for tensor in tensors):
        return None
    capacity, start, storage = means.stride(1), means.storage_offset(), means.untyped_storage()
    if capacity % LANES or capacity < len(means) or storage.nbytes() < 4 * (start + layout.ROWS * capacity):
        return None
    for (first, _), tensor in zip(_ROWS, tensors):
        if (
            tensor.untyped_storage().data_ptr() != storage.data_ptr()
            or tensor.storage_offset() != start + first * capacity
            or tensor.stride() != (1, capacity)[: tensor.dim()]
        ):
            return None
    return torch.as_strided(means, (layout.ROWS, capacity), (capacity, 1), start).numpy()


@_inline
def _to_rows(block, row, values, size, first, last):
    """Copy ``values[i, d]`` to ``block[row + d, i]`` for d below ``size`` and i from ``first`` to ``last - 1``.

    The indices are flat, so that the loops are vectorised.
    """
    capacity = block.shape[1]
    for d in range(size):
        for i in range(first, last):
            memory.poke(block, (row + d) * capacity + i, memory.peek(values, size * i + d))


@_inline
def _from_rows(block, row, values, size, first, last):
    capacity = block.shape[1]
    for d in range(size):
        for i in range(first, last):
            memory.poke(values, size * i + d, memory.peek(block, (row + d) * capacity + i))


@kernel
def _pack(tickets, block, means, quaternions, log_scales, logits, colors):
    count = means.shape[0]
    while True:
        first = layout.CHUNK * counters.take_ticket(tickets, 0)
        if first >= count:
            return
        last = min(first + layout.CHUNK, count)
        _to_rows(block, 0, means, 3, first, last)
        _to_rows(block, 3, quaternions, 4, first, last)
        _to_rows(block, 7, log_scales, 3, first, last)
        _to_rows(block, 10, logits, 1, first, last)
        _to_rows(block, 11, colors, 3, first, last)


@kernel
def _unpack(tickets, block, means, quaternions, log_scales, logits, colors):
    count = means.shape[0]
    while True:
        first = layout.CHUNK * counters.take_ticket(tickets, 0)
        if first >= count:
            return
        last = min(first + layout.CHUNK, count)
        _from_rows(block, 0, means, 3, first, last)
        _from_rows(block, 3, quaternions, 4, first, last)
        _from_rows(block, 7, log_scales, 3, first, last)
        _from_rows(block, 10, logits, 1, first, last)
        _from_rows(block, 11, colors, 3, first, last)
