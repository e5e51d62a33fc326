"""Damage to files: bytes, numbers in text, trees of JSON."""

from __future__ import annotations

import json
import re
from typing import Any

import numpy as np

_NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
_WORDS = (b"0", b"-1", b"-0.0", b"1", b"3", b"255", b"65536", b"2147483647", b"4294967295", b"-2147483649",
          b"9223372036854775807", b"18446744073709551616", b"1e308", b"-1e308", b"1e-320", b"1e999", b"nan", b"NaN",
          b"-inf", b"Infinity", b"0x10", b"1,5", b"x", b"", b"null", b"[]", b"9" * 5000, b"0" * 300 + b"1",
          b"\xff\xfe", b"\x00", b"<a>", b"&amp;", b"\n", b"\x1b[1A\x07\r")  # fmt: skip
_VALUES: tuple[Any, ...] = (
    "\x1b[2K\x1b[1A\x1b]0;x\x07\r\x9b8m\u202e",  # moves a terminal's cursor, names its window, turns text around
    0, -1, 1, 2, 7, 2**31 - 1, 2**31, 2**32, 2**63, -(2**63), 10**30, 1e308, -1e308, 1e-320, 0.5, float("nan"),
    float("inf"), "", "x", "0", "a\nb", "../..", "/dev/zero", "x" * 3000, None, True, False, [], {}, [[]], [0] * 50,
    [None], {"a": 1}, [1e308, 1e308, 1e308], "data:;base64,####", "data:,", 4, 5, 6, 5120, 5126,
)  # fmt: skip


def damaged_bytes(rng: np.random.Generator, data: bytes) -> bytes:
    """One kind of damage somewhere."""
    if not data:
        return b"\0"
    at = int(rng.integers(len(data)))
    length = int(min(rng.geometric(0.03), len(data) - at))
    kind = rng.integers(8)
    if kind == 0:
        return data[:at]
    if kind == 1:
        return data[:at] + data[at + length :]
    if kind == 2:
        return data[:at] + data[at : at + length] * int(rng.integers(2, 30)) + data[at + length :]
    if kind == 3:
        return data[:at] + rng.bytes(length) + data[at + length :]
    if kind == 4:
        return data[:at] + bytes([int(rng.choice([0, 255, 127, 128]))]) * length + data[at + length :]
    if kind == 5:  # an aligned word, as headers hold
        word = int(rng.choice([0, 1, 2**16, 2**31 - 1, 2**31, 2**32 - 1])).to_bytes(4, "little")
        at -= at % 4
        return data[:at] + word + data[at + 4 :]
    spoilt = bytearray(data)
    for place in rng.integers(len(data), size=1 if kind == 6 else 12):
        spoilt[place] ^= 1 << int(rng.integers(8))
    return bytes(spoilt)


def damaged_text(rng: np.random.Generator, text: bytes) -> bytes:
    """A number replaced, or lines lost, doubled or swapped."""
    kind = rng.integers(6)
    if kind < 3:
        numbers = list(_NUMBER.finditer(text))
        for found in sorted(rng.choice(len(numbers), min(len(numbers), 1 + int(kind)), replace=False))[::-1]:
            match = numbers[found]
            text = text[: match.start()] + _WORDS[rng.integers(len(_WORDS))] + text[match.end() :]
        return text
    lines = text.split(b"\n")
    a, b = rng.integers(len(lines), size=2)
    if kind == 3:
        del lines[a]
    elif kind == 4:
        lines[a:a] = lines[min(a, b) : max(a, b) + 1] * int(rng.integers(1, 20))
    else:
        lines[a], lines[b] = lines[b], lines[a]
    return b"\n".join(lines)


def damaged_json(rng: np.random.Generator, text: bytes) -> bytes:
    """A value somewhere in the tree replaced, removed, doubled or nested."""
    tree = json.loads(text)
    for _ in range(int(rng.integers(1, 4))):
        holder, key = _place(rng, tree)
        kind = rng.integers(9)
        if kind == 8:
            _other_length(rng, tree)
        elif kind < 4:
            holder[key] = _VALUES[rng.integers(len(_VALUES))]
        elif kind == 4:
            del holder[key]
        elif kind == 5:
            for _ in range(int(rng.integers(1, 6))):
                holder[key] = [holder[key]]
        elif kind == 6 and isinstance(holder[key], list):
            holder[key] = holder[key] * int(rng.integers(2, 50))
        else:
            holder[key] = {"x": holder[key]}
    return json.dumps(tree).encode()


def _other_length(rng: np.random.Generator, tree: Any) -> None:
    """One entry more or less in some list of the tree."""
    lists, stack = [], [tree]
    while stack:
        holder = stack.pop()
        lists += [holder] if isinstance(holder, list) and holder else []
        stack += [value for value in (holder.values() if isinstance(holder, dict) else holder)
                  if isinstance(value, dict | list)]  # fmt: skip
    if lists:
        chosen = lists[rng.integers(len(lists))]
        chosen.append(chosen[-1]) if rng.random() < 0.5 else chosen.pop()


def _place(rng: np.random.Generator, tree: Any) -> tuple[Any, Any]:
    """A container in the tree and a key of it."""
    places = []
    stack = [tree]
    while stack:
        holder = stack.pop()
        for key, value in holder.items() if isinstance(holder, dict) else enumerate(holder):
            places.append((holder, key))
            if isinstance(value, dict | list):
                stack.append(value)
    return places[rng.integers(len(places))] if places else ({"x": 0}, "x")
