"""Look up the sizes of ProcTHOR's assets in the bounding boxes that [procthor] publishes."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

import numpy as np

_FILE = Path(__file__).with_name("procthor_assets") / "sizes.txt"


def asset_size(name: str) -> tuple[np.ndarray | None, bool]:
    """Return the size [3] of an asset along ProcTHOR's axes (y up) in metres, and whether it is the published one.

    An unlisted asset gets the median of the listed assets of its kind, such as ``Bed`` for ``Bed_99``; None if there is
    no such kind.
    """
    sizes, medians = _tables()
    return (sizes[name], True) if name in sizes else (medians.get(_kind(name)), False)


@cache
def _tables() -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Return the sizes of the assets by name, and the median sizes by kind."""
    sizes: dict[str, np.ndarray] = {}
    for line in _FILE.read_text(encoding="utf-8").splitlines():
        if not line.startswith("#"):
            name, *numbers = line.split()
            sizes[name] = np.array(numbers, dtype=np.float64)
    kinds: dict[str, list[np.ndarray]] = {}
    for name, size in sizes.items():
        kinds.setdefault(_kind(name), []).append(size)
    return sizes, {kind: np.median(found, axis=0) for kind, found in kinds.items()}


def _kind(name: str) -> str:
    """Return the letters before the first number of a name, as ``diningtable`` for ``Dining_Table_27_1``."""
    return re.split(r"[\d|]", name)[0].replace("_", "").lower()
