"""Read JSON files of scenes, and report faults as `InputError`."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from activestructure_gym.errors import InputError
from activestructure_gym.scenes.loaders.budget import SceneBudget

T = TypeVar("T")


def read_json(path: Path, what: str, parse: Callable[[Any], T]) -> T:
    """Return ``parse(content)`` of a JSON file.

    Raises `InputError` if the file cannot be read or parsed; ``what`` describes the expected content in the message.
    """
    try:
        return parse(json.loads(SceneBudget().read(path).decode("utf-8-sig")))
    except KeyError as error:
        reason = f"{error} is missing"
    except (TypeError, AttributeError):
        reason = "a part of it is of another kind"
    except RecursionError:
        reason = "it is nested too deeply"
    except (ValueError, OverflowError, OSError) as error:
        reason = " ".join(str(error).split())[:200]
    raise InputError(f"'{path}' is not {what}: {reason}")
