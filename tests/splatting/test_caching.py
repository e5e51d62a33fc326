import sys
from types import ModuleType

import numba
import numpy as np

from activestructure_gym.splatting import kernels
from activestructure_gym.splatting.caching import stamp_of
from activestructure_gym.splatting.passes import _make_median


def _module(tmp_path, name, source):
    path = tmp_path / f"{name}.py"
    path.write_text(source)
    module = ModuleType(name)
    module.__file__ = str(path)
    return module


def test_stamp_follows_the_source(tmp_path, monkeypatch):
    first, same, other = (
        _module(tmp_path, name, source) for name, source in (("a", "X = 1\n"), ("b", "X = 1\n"), ("c", "X = 2\n"))
    )
    for module in (first, same, other):
        monkeypatch.setitem(sys.modules, module.__name__, module)
    assert stamp_of(first) == stamp_of(same) != stamp_of(other)
    assert stamp_of(first, other) != stamp_of(first)
    assert 0 <= stamp_of(kernels) < 2**56


def test_another_stamp_is_another_compilation(tmp_path, monkeypatch):
    """numba keys its cache by the closure: the same stamp is found on disk, another one is compiled anew."""
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))

    def load(stamp):
        kernel = _make_median(stamp)
        grid = np.zeros(kernels.GRID_SIZE, np.int64)  # no tiles: the kernel returns at once
        numbers, floats = np.zeros(1, np.int64), np.zeros(kernels.VIEW_SIZE, np.float32)
        kernel(numbers, floats, grid, floats, numbers, numbers, np.zeros((kernels.ENTRY_ROWS, 0), np.uint64), floats)
        return sum(kernel.stats.cache_hits.values()), sum(kernel.stats.cache_misses.values())

    assert load(1) == (0, 1)
    assert load(1) == (1, 0)
    assert load(2) == (0, 1)
