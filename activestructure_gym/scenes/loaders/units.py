"""Convert file units to metres, and check whether the size and the ceiling height of a scene are plausible."""

from __future__ import annotations

import numpy as np

from activestructure_gym.errors import InputError, unknown_name
from activestructure_gym.scenes.loaders.upright import CEILING_HEIGHTS
from activestructure_gym.scenes.scene import Scene

METRES_PER_UNIT = {"m": 1.0, "dm": 0.1, "cm": 0.01, "mm": 0.001, "in": 0.0254, "ft": 0.3048}
_USUAL_HEIGHT = 2.6  # metres, height of a room


def metres_per_unit(units: str | float) -> float:
    """Return the metres per file unit of a unit's name or of a number; raise `InputError` if it is neither."""
    if isinstance(units, str) and units in METRES_PER_UNIT:
        return METRES_PER_UNIT[units]
    try:
        scale = float(units)
    except ValueError:
        raise unknown_name("unit", str(units), METRES_PER_UNIT) from None
    if not 1e-9 <= scale <= 1e9:
        raise InputError(f"units as a number must be metres per file unit above 0, from 1e-9 to 1e9, got {units}")
    return scale


def units_hint(extent: np.ndarray, length: float, low: float, high: float) -> str:
    """Return a text that suggests the units in which a length is between ``low`` and ``high`` metres.

    The most plausible unit comes first. The extent [3] and the length are in file units. A unit is plausible if the
    shortest side, which is usually the height of a room, is near 2.6 m.
    """
    fitting = [unit for unit, metres in METRES_PER_UNIT.items() if low <= length * metres <= high]
    if not fitting:
        return "pass units= as metres per file unit"
    height = extent.min() if (extent > 0).all() else length
    fitting.sort(key=lambda unit: abs(np.log(height * METRES_PER_UNIT[unit] / _USUAL_HEIGHT)))
    sizes = [" x ".join(f"{side * METRES_PER_UNIT[unit]:.1f}" for side in extent) for unit in fitting]
    return "try " + " or ".join(f"units={unit} ({size} m)" for unit, size in zip(fitting, sizes))


def scale_note(scene: Scene, scale: float = 1.0) -> tuple[str, bool]:
    """Return a note on a scene's size and ceiling height, and whether the ceiling height is plausible.

    ``scale`` is metres per file unit; the note suggests other units if the height is unusual.
    """
    low, high = scene.bounds
    size = " x ".join(f"{side:.2f}" for side in high - low)
    height = ceiling_height(scene)
    if height is None:
        return f"{size} m (x, y, z), no ceiling found: check that the unit is metres (option units)", False
    if CEILING_HEIGHTS[0] <= height <= CEILING_HEIGHTS[1]:
        return f"{size} m (x, y, z), ceiling height {height:.2f} m: plausible", True
    hint = units_hint((high - low) / scale, height / scale, 2.2, 4.0)
    return f"{size} m (x, y, z), ceiling height {height:.2f} m: unusual; if the unit is wrong, {hint}", False


def ceiling_height(scene: Scene) -> float | None:
    """Return the height in metres between floor and ceiling, or None without a ceiling.

    The scene has no ceiling if fewer than a tenth of the tested vertical lines meet a floor and a ceiling. It also has
    none if fewer than half of the lines between walls and above a floor do. The second test excludes the tops of
    furniture in rooms without ceiling.
    """
    low, high = scene.bounds
    grid = (np.arange(24) + 0.5) / 24
    x, y, z = np.meshgrid(grid, grid, (0.25, 0.5, 0.75), indexing="ij")
    starts = low + np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1) * (high - low)

    def length(*way: float) -> np.ndarray:
        return scene.raycaster.cast(starts, np.tile(way, (len(starts), 1))).distance

    up, down = length(0.0, 0.0, 1.0), length(0.0, 0.0, -1.0)
    total = (up + down)[np.isfinite(up + down)]
    angles = np.arange(8) * np.pi / 4
    walls = sum(np.isfinite(length(np.cos(angle), np.sin(angle), 0.0)).astype(int) for angle in angles)
    indoors = np.isfinite(down) & (walls >= 6)
    if len(total) <= 0.1 * len(starts) or np.isfinite(up[indoors]).sum() < 0.5 * indoors.sum():
        return None
    # Furniture shortens lines and nothing lengthens them, so the height of the room is among the longest lines.
    return float(np.percentile(total, 75))
