"""Parse numbers in the text of COLLADA elements and attributes, with clear errors."""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np

from activestructure_gym.scenes.loaders.damage import UnreadableMesh


def floats(text: str | None) -> np.ndarray:
    """Return the numbers in a text, which are separated by blanks."""
    return _numbers(text, np.float64)


def fixed(text: str | None, count: int, name: str) -> np.ndarray:  # [count]
    """Return the ``count`` numbers in the text of a <name> element; raise `UnreadableMesh` for another number."""
    values = floats(text)
    if len(values) != count:
        raise UnreadableMesh(f"a <{name}> has {len(values)} numbers instead of {count}")
    return values


def attribute(element: ElementTree.Element, name: str, default: int = 0) -> int:
    """Return the value of an attribute, a non-negative integer; raise `UnreadableMesh` for another value."""
    text = element.get(name, str(default)).strip()
    if not text.isdecimal() or len(text) > 9:
        raise UnreadableMesh(f'{name}="{text[:40]}" of an <{element.tag}> is not a whole number from 0 on')
    return int(text)


def integers(text: str | None) -> np.ndarray:
    """Return the integers in a text, which are separated by blanks."""
    return _numbers(text, np.int64)


def _numbers(text: str | None, kind: type) -> np.ndarray:
    words = (text or "").split()
    try:
        return np.array(words, dtype=kind)
    except (ValueError, OverflowError):
        if any("," in word for word in words):
            raise UnreadableMesh(
                "its numbers are written with commas (0,5 for 0.5); export it with decimal points"
            ) from None
        wanted = "whole numbers" if kind is np.int64 else "numbers"
        raise UnreadableMesh(f"'{_first_odd(words, kind)}' was found where {wanted} are expected") from None


def _first_odd(words: list[str], kind: type) -> str:
    for word in words:
        try:
            np.array([word], dtype=kind)
        except (ValueError, OverflowError):
            return word[:40]
    return words[0][:40]
