"""Parse the values of command-line options; a wrong value raises `InputError`."""

from __future__ import annotations

import json
import math
import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from activestructure_gym.errors import InputError, short_repr, unknown_name
from activestructure_gym.registry import TRUST
from activestructure_gym.specs import Spec

# A number after a comma in a scene's options, such as 3 and 2.5 in box?size=4,3,2.5.
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")
_MAX_SEEDS = 10_000  # largest number of seeds in a range such as 0-4
_POINT = re.compile(r"[-+]?(\d+\.|\d*\.\d+)")  # a number with a decimal point; JSON does not accept ``.9`` and ``1.``


def split_list(words: Sequence[str]) -> tuple[str, ...]:
    """Split words at commas, except commas between numbers in a scene's option, as in box?size=4,3,2.5."""
    items: list[str] = []
    for word in words:
        for number, part in enumerate(word.split(",")):
            if number and items and "?" in items[-1] and _NUMBER.fullmatch(part.partition("&")[0].strip()):
                items[-1] += f",{part}"
            elif part.strip():
                items.append(part.strip())
    return tuple(items)


def split_scenes(words: Sequence[str]) -> tuple[str, ...]:
    """Split words at commas like `split_list`, but do not split names of existing files and folders.

    A file name may be followed by options and preceded by a kind, as in ``replica:PATH?option=value``.
    """
    items: list[str] = []
    for word in words:
        ends = [len(word), *(place for place, letter in enumerate(word) if letter == "?")]
        file = next((word[:end] for end in ends if _is_there(word[:end])), "")
        if file:
            first, *others = split_list(["?" + word[len(file) + 1 :]])  # first: the options after the file name
            items += [file + first if file != word else file, *others]
        else:
            items += split_list([word])
    return tuple(items)


def _is_there(word: str) -> bool:
    """Return whether ``word``, or the part of it after the first colon, is an existing file or folder."""
    return any(os.path.exists(os.path.expanduser(name)) for name in (word, word.partition(":")[2]) if name)


def split_policies(words: Sequence[str]) -> tuple[Spec, ...]:
    """Split words at commas into names of policies.

    ``ladder`` is replaced by the variants A to E of the paper's Table 3, and ``all`` by all registered policies. Raise
    `InputError` for an unknown name that is not ``package.module:Class``, and for a reference such as the oracle.
    """
    from activestructure_gym.policies import POLICIES
    from activestructure_gym.policies.activestructure import LADDER

    groups: dict[str, Sequence[str]] = {"ladder": LADDER, "all": tuple(POLICIES)}
    for word in split_list(words):
        spec = Spec(word)
        name = spec.name
        if spec.kind == "reference":
            raise InputError(f"'{word}' is not a policy: ask for it by --references {spec.place}")
        if name not in groups and name not in POLICIES and ":" not in name:
            raise unknown_name("policy", name, (*POLICIES, *groups))
    return tuple(Spec(name) for word in split_list(words) for name in groups.get(word, (word,)))


def parse_seeds(words: Sequence[str]) -> tuple[int, ...]:
    """Parse seeds: whole numbers from 0 on, or ranges such as ``0-4``, which includes 4."""
    seeds: list[int] = []
    for text in split_list(words):
        ends = text.split("-")
        if len(ends) > 2 or not all(end.isascii() and end.isdigit() and len(end) < 20 for end in ends):
            raise InputError(
                f"a seed is a whole number of at least 0, and several are written 0,2,5 or 0-4; got {short_repr(text)}"
            )
        first, last = int(ends[0]), int(ends[-1])
        if not 0 <= last - first < _MAX_SEEDS:
            raise InputError(f"a range of seeds has at most {_MAX_SEEDS}, the smallest first; got {short_repr(text)}")
        seeds += range(first, last + 1)
    return tuple(seeds)


def parse_start(text: str | None) -> tuple[float, float, float, float] | None:
    """Parse a start pose ``x,y,z,yaw`` in metres and degrees, or return None for None."""
    if text is None:
        return None
    try:
        x, y, z, yaw = (float(part) for part in text.split(","))
    except ValueError:
        x = y = z = yaw = math.nan
    if not all(map(math.isfinite, (x, y, z, yaw))):
        raise InputError(f"--start is x,y,z,yaw in metres and degrees, four numbers, got {short_repr(text)}")
    return x, y, z, yaw


def start_of(text: str | None, scenes: Sequence[str]) -> tuple[float, float, float, float] | None:
    """Parse the value of ``--start``: a start pose as for `parse_start`, or "published".

    "published" is the start pose that papers use in the scene; ``scenes`` must then have one entry.
    """
    if text != "published":
        return parse_start(text)
    if len(scenes) != 1:
        raise InputError(
            f"--start published takes one scene, got {len(scenes)}; compare on one after the other, and give "
            "all their directories to `asg report`"
        )
    from activestructure_gym.scenes.datasets import published_start
    from activestructure_gym.scenes.library import load_scene

    return published_start(load_scene(scenes[0]))


def parse_overrides(words: Sequence[str]) -> dict[str, Any]:
    """Parse ``key=value`` words; a value is JSON, a number such as ``.9``, True, False or None, and otherwise text."""
    overrides = {}
    for word in words:
        key, equals, value = word.partition("=")
        if not (key and equals):
            raise InputError(f"--set takes key=value, as in sensor.depth_noise=kinect, got {short_repr(word)}")
        overrides[key] = _value("--set", key, value)
    return overrides


def parse_sweep(words: Sequence[str]) -> dict[str, tuple[Any, ...]]:
    """Parse ``key=value,value`` words; commas separate values of the forms that `parse_overrides` takes."""
    sweep: dict[str, tuple[Any, ...]] = {}
    for word in words:
        key, equals, text = word.partition("=")
        if not (key and equals):
            raise InputError(f"--sweep takes key=value,value, as in mapper.iterations=5,15, got {short_repr(word)}")
        if key in sweep:
            raise InputError(f"--sweep names {short_repr(key)} twice: give all its values once, separated by commas")
        try:
            sweep[key] = tuple(json.loads(f"[{text}]"))  # commas within lists and tables separate no values
        except (RecursionError, ValueError):
            parts = [text] if text[:1] in ("[", "{") else text.split(",")
            sweep[key] = tuple(_value("--sweep", key, part) for part in parts)
        if not all(value != "" for value in sweep[key]) or not sweep[key]:
            raise InputError(f"--sweep {short_repr(key)} lacks a value, got {short_repr(text)}")
    return sweep


def _value(option: str, key: str, text: str) -> Any:
    """Parse one value of the field ``key``; ``option`` is named in the `InputError` for a wrong one."""
    try:
        return json.loads(text)
    except (RecursionError, ValueError) as error:
        if not isinstance(error, json.JSONDecodeError):  # too deeply nested, or a number with thousands of digits
            raise InputError(f"{option} {short_repr(key)} takes no such value, got {short_repr(text)}") from None
        if text[:1] in ("[", "{"):
            raise InputError(
                f'{option} {short_repr(key)}: lists and tables are JSON, as in \'views.stages=[["pool", "turns"]]\' '
                f"with all its quotes, got {short_repr(text)}"
            ) from None
        number = float(text) if _POINT.fullmatch(text) else text
        return {"True": True, "False": False, "None": None}.get(text, number)


def parse_labels(words: Sequence[str]) -> dict[str, str]:
    """Parse ``NAME=TEXT`` words into the labels of a report; the last equals sign separates, since names have some."""
    labels = {}
    for word in words:
        name, equals, text = word.rpartition("=")
        if not (name and equals and text.strip()):
            raise InputError(f"--labels takes NAME=TEXT, as in activestructure=Ours, got {short_repr(word)}")
        labels[name] = text.strip()
    return labels


def use_lpips_weights(place: str | None) -> None:
    """Set the folder ``place`` of the LPIPS weights for this process and its children; None changes nothing.

    Raise `InputError` if a weight file is missing.
    """
    from activestructure_gym.evaluation.metrics import lpips

    before = os.environ.get(lpips.VARIABLE)
    if place is not None:
        os.environ[lpips.VARIABLE] = str(Path(os.path.expanduser(place)).absolute())
    if not os.environ.get(lpips.VARIABLE):
        return
    try:
        lpips.weights_name()
    except InputError:
        del os.environ[lpips.VARIABLE]
        if before is not None:
            os.environ[lpips.VARIABLE] = before
        raise


def use_trust(trusted: bool) -> None:
    """Allow this process and its children to run code that recorded files name, if ``trusted``.

    See `registry.refuse_code`.
    """
    if trusted:
        os.environ[TRUST] = "1"
