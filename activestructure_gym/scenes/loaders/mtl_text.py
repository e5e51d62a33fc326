"""Parse a texture statement of an MTL file: its options and its file.

Options precede the file name in any order; the name may contain blanks ([mtl1995], "Options for texture map
statements").
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from activestructure_gym.scenes.scene import CLAMP, REPEAT

# Options with numbers, and the maximum number of their values.
_NUMBERS = {"-s": 3, "-o": 3, "-t": 3, "-mm": 2, "-bm": 1, "-boost": 1, "-texres": 1}
_SWITCH = ("on", "off")
_WORDS = {
    **dict.fromkeys(("-clamp", "-blendu", "-blendv", "-cc"), _SWITCH),
    "-imfchan": ("r", "g", "b", "m", "l", "z"),
    "-type": ("sphere", *(f"cube_{side}" for side in ("top", "bottom", "front", "back", "left", "right"))),
}
# Values of options that have no effect, and options that only change the filtering.
_IDLE = {"-t": (0.0, 0.0, 0.0), "-mm": (0.0, 1.0), "-cc": "off", "-blendu": "on", "-blendv": "on"}
_OF_FILTERS = ("-boost", "-texres", "-bm")
_READ = ("-s", "-o", "-clamp", "-imfchan")

_WORD = re.compile(r"\s*(\S+)")
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?", re.IGNORECASE)
_ODD_OPTION = re.compile(r"-[a-z_]+(?=\s)", re.IGNORECASE)


@dataclass(frozen=True)
class TextureMap:
    """Hold a texture of an MTL file and its placement."""

    reference: str  # file name as written; "" if missing
    scale: tuple[float, float] = (1.0, 1.0)
    offset: tuple[float, float] = (0.0, 0.0)
    clamp: bool = False
    channel: str = ""  # "r", "g", "b", "m" (matte, the alpha), "l" (luminance) or "z"; "" if not given
    ignored: tuple[str, ...] = ()  # unsupported options that change the appearance, with their values

    @property
    def wrap(self) -> tuple[int, int]:
        """Return the wrap modes outside the image, across and down."""
        return (CLAMP, CLAMP) if self.clamp else (REPEAT, REPEAT)

    def placed(self, uv: np.ndarray) -> np.ndarray:  # [V, 2] -> [V, 2], v up
        """Return the image coordinates: offset + scale x the mesh's coordinates ``uv``."""
        return uv * self.scale + self.offset


def texture_map(statement: str) -> TextureMap:
    """Return the texture and its options from the text after a keyword such as `map_Kd` or `map_d`.

    If an option is repeated, the last values count. Omitted numbers are 1 for `-s` and 0 for `-o`.
    """
    values: dict[str, tuple[float, ...] | str] = {}
    place = 0
    while (found := _WORD.match(statement, place)) and (option := found[1].lower()) in (*_NUMBERS, *_WORDS):
        place = found.end()
        if option in _NUMBERS:
            values[option], place = _numbers(statement, place, _NUMBERS[option])
            continue
        word = _WORD.match(statement, place)
        known = word is not None and word[1].lower() in _WORDS[option]
        values[option] = word[1].lower() if word and known else ""
        place = word.end() if word and known else place
    reference = statement[place:].strip()
    if len(reference) > 1 and reference[0] == reference[-1] and reference[0] in "\"'":
        reference = reference[1:-1]
    ignored = [_written(option, value) for option, value in values.items() if _matters(option, value)]
    ignored += [odd[0] for odd in [_ODD_OPTION.match(reference)] if odd]
    return TextureMap(
        reference,
        scale=_pair(values.get("-s"), 1.0),
        offset=_pair(values.get("-o"), 0.0),
        clamp=values.get("-clamp") == "on",
        channel=str(values.get("-imfchan", "")),
        ignored=tuple(ignored),
    )


# Values of -imfchan as channels of `opacity_picture`.
OPACITY_CHANNELS = {"m": "alpha", "l": "luminance", "r": "r", "g": "g", "b": "b"}


def dissolve(d: Sequence[str] | None, tr: Sequence[str] | None) -> float:
    """Return the opacity given by the words after `d` (1 = solid) and `Tr` (0 = solid); `d` overrides `Tr`."""
    solid, transparent = (_last_number(words) for words in (d, tr))
    if solid is None:
        solid = 1.0 if transparent is None else 1.0 - transparent
    return min(max(solid, 0.0), 1.0)


def _last_number(words: Sequence[str] | None) -> float | None:
    """Return the last number among the words, which may include options such as -halo; None if there is none."""
    numbers = [float(word) for word in words or () if _NUMBER.fullmatch(word)]
    return numbers[-1] if numbers else None


def _numbers(statement: str, place: int, most: int) -> tuple[tuple[float, ...], int]:
    """Return up to ``most`` numbers of a statement starting at the position ``place``, and the position after them."""
    numbers: list[float] = []
    while len(numbers) < most and (word := _WORD.match(statement, place)) and _NUMBER.fullmatch(word[1]):
        numbers.append(float(word[1]))
        place = word.end()
    return tuple(numbers), place


def _pair(numbers: tuple[float, ...] | str | None, default: float) -> tuple[float, float]:
    first, second = (*(numbers or ()), default, default)[:2]
    return float(first), float(second)


def _matters(option: str, value: tuple[float, ...] | str) -> bool:
    """Return whether an option with this value is unsupported and changes the appearance; True for an empty value."""
    if not value:
        return True
    if option in _READ or option in _OF_FILTERS:
        return False
    idle = _IDLE.get(option, "")
    return value != (idle[: len(value)] if isinstance(value, tuple) else idle)


def _written(option: str, value: tuple[float, ...] | str) -> str:
    words = [value] if isinstance(value, str) else [f"{number:g}" for number in value]
    return " ".join([option, *words]).strip()
