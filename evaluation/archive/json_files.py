"""Write and read JSON files: whole, finite, and in one form."""

from __future__ import annotations

import json
import math
import os
from pathlib import Path
from typing import Any

import numpy as np

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.archive import schema
from activestructure_gym.files import replaced


def write_json(path: Path, content: Any) -> None:
    """Replace a JSON file atomically: readers see either the old or the new content."""
    with replaced(path) as file:
        file.write(json_text(content).encode("utf-8"))


def json_text(content: Any) -> str:
    """Return the text of a JSON file with this content."""
    return json.dumps(plain(content), indent=1, allow_nan=False) + "\n"


def json_line(content: Any) -> str:
    """Return one line of a JSON lines file."""
    return json.dumps(plain(content), allow_nan=False, separators=(",", ":")) + "\n"


def read_json(path: Path, check: schema.Check = schema.anything, *, remedy: str = "") -> Any:
    """Return the content of a JSON file; raise `InputError` with the ``remedy`` if it cannot be read or checked."""
    try:
        return schema.read_checked_json(path, check)
    except (OSError, ValueError) as error:
        raise unreadable(path, error, remedy) from error


def unreadable(path: Path, reason: Exception | str, remedy: str) -> InputError:
    """Return the `InputError` about a file that cannot be read, with the remedy."""
    remedy = f"; {remedy}" if remedy else ""
    if isinstance(reason, FileNotFoundError):
        return InputError(f"'{path}' is missing{remedy}")
    if isinstance(reason, OSError):
        return InputError(f"'{path}' cannot be read: {reason.strerror or reason}{remedy}")
    if isinstance(reason, InputError) and str(path) in str(reason):  # the reason already names the file
        return InputError(f"{reason}{remedy}")
    return InputError(f"'{path}' is damaged: {reason}{remedy}")


def as_read(content: Any) -> Any:
    """Return ``content`` as it would be read from a JSON file to which it was written."""
    return json.loads(json_text(content))


def plain(value: Any) -> Any:
    """Convert ``value`` to JSON's types; NaN and infinity become null."""
    if isinstance(value, dict):
        return {str(key): plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [plain(entry) for entry in value]
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    raise TypeError(f"{type(value).__name__} cannot be written as JSON")
