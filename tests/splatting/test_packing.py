import numpy as np
import pytest
import torch

from activestructure_gym.splatting.packing import packed, parameter_rows, unpacked

SLICES = (slice(0, 3), slice(3, 7), slice(7, 10), 10, slice(11, 14))


def _columns(block, count):
    """The five tensors as `rasterize` takes them."""
    rows = parameter_rows(block)
    return tuple(row[:count] if row.dim() == 1 else row.T[:count] for row in rows)


@pytest.mark.parametrize("count", (0, 1, 16, 1023, 1024, 2500))
def test_there_and_back(count):
    block = torch.arange(14.0 * count).reshape(14, count)
    tensors = tuple(tensor.contiguous() for tensor in _columns(block, count))
    array = packed(tensors, 2)
    assert array.shape == (14, -(-count // 16) * 16) and array.dtype == np.float32
    assert np.array_equal(array[:, :count], block.numpy()) and not array[:, count:].any()
    for tensor, back in zip(tensors, unpacked(array, tensors, 2)):
        assert torch.equal(tensor, back) and back.is_contiguous()


def test_own_memory_is_used_where_it_lies_right():
    room = torch.randn(14 * 64 + 5)
    block = room[5:].reshape(14, 64)
    for count in (1, 50, 64):
        array = packed(_columns(block, count), 1)
        assert array.ctypes.data == block.data_ptr() and array.shape == (14, 64)
        results = unpacked(array, _columns(block, count), 1)
        if count > 1:  # one row of a tensor is contiguous however it lies
            offsets = [(result.data_ptr() - block.data_ptr()) // (4 * 64) for result in results]
            assert offsets == [0, 3, 7, 10, 11]


@pytest.mark.parametrize("change", ("odd length", "another order", "another block", "no colors", "half a block"))
def test_other_layouts_are_copied(change):
    block, count = torch.randn(14, 64), 64
    tensors = list(_columns(block, count))
    if change == "odd length":
        block = block[:, :50].contiguous()
        tensors = list(_columns(block, count := 50))
    elif change == "another order":
        tensors[0], tensors[2] = tensors[2], tensors[0]
    elif change == "another block":
        tensors[3] = tensors[3].clone()
    elif change == "half a block":
        tensors[4] = torch.randn(3, 128)[:, ::2].T
    else:
        tensors[4] = None
    array = packed(tuple(tensors), 1)
    for rows, tensor in zip(SLICES, tensors):
        if tensor is not None:
            assert np.array_equal(array[rows, :count], tensor.T.numpy() if tensor.dim() == 2 else tensor.numpy())
    assert array.ctypes.data != block.data_ptr()
    for tensor, back in zip(tensors, unpacked(array, tuple(tensors), 1)):
        assert (tensor is None and back is None) or torch.equal(tensor, back)
