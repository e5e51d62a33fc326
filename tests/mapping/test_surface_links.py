"""Links between neighbouring pixels, against their definition pixel by pixel."""

from __future__ import annotations

import numpy as np
import pytest

from activestructure_gym.mapping.surface_links import BELOW, RIGHT, surface_links


def _on_plane(near: float, beyond: float, target: float, share: float) -> bool:
    if min(near, beyond, target) <= 0:
        return False
    inverse = 2 / near - 1 / beyond
    return inverse > 0 and abs(1 / inverse - target) < share * target


def _joined(line: list[float]) -> bool:
    """Return whether pixels 2 and 3 of six in a line are on one surface; 0 = no return or outside the image."""
    agrees = False
    for three, two, one, target in (line[:4], line[:1:-1]):
        agrees |= _on_plane(one, two, target, 0.02)
        if not _on_plane(one, two, target, 0.04) and _on_plane(two, three, one, 0.02):
            return False
    return agrees


@pytest.mark.parametrize("size", [(1, 1), (1, 7), (2, 5), (3, 2), (24, 31)])
def test_links_are_those_of_the_definition(size: tuple[int, int]) -> None:
    rng, (rows, columns) = np.random.default_rng(0), np.indices(size)
    depth = 1 / (0.3 + 0.01 * rows + 0.005 * columns)  # a plane
    depth *= np.where((rows // 6 + columns // 8) % 2 == 0, 1.0, 1.03) * rng.uniform(0.99, 1.01, size)
    depth = np.where(rng.random(size) < 0.05, 0.0, depth).astype(np.float32)
    links, padded = surface_links(depth), np.pad(depth.astype(float), 3)
    for row, column in np.ndindex(*size):
        across = padded[row + 3, column + 1 : column + 7].tolist()
        down = padded[row + 1 : row + 7, column + 3].tolist()
        assert links[row, column] == RIGHT * _joined(across) + BELOW * _joined(down)
    if min(size) > 20:
        assert 0.1 < (links & RIGHT > 0).mean() < 0.9 and 0.1 < (links & BELOW > 0).mean() < 0.9
