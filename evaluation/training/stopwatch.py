"""Measure the time of each part of a training run, and write ``timing.json``; no other file of a run holds times."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.archive.json_files import read_json, write_json
from activestructure_gym.evaluation.archive.schema import number, table
from activestructure_gym.evaluation.machine import hardware as machine
from activestructure_gym.evaluation.machine.processes import processor_seconds

_SECONDS = number(0)
_CHECK = table({
    "sittings": number(0, whole=True),
    "parts": table(others=table({"wall_s": _SECONDS, "processor_s": _SECONDS}, others=_SECONDS)),
})  # fmt: skip


class Timing:
    """Add up the wall time and the processor time of each part of a training run, over all its sittings.

    A sitting lasts from a start of the run to its end or its interruption. Processor time includes all descendants of
    this process. All times are in seconds.
    """

    def __init__(self, file: Path) -> None:
        self._file = file
        found: dict[str, Any] = {}
        try:
            found = read_json(file, _CHECK)
            self._parts = {name: dict(values) for name, values in found["parts"].items()}
        except InputError:  # missing or damaged: begin from 0, since times are not results
            found, self._parts = {}, {}
        self._sittings = int(found.get("sittings", 0)) + 1
        self._part: str | None = None
        self._began = (0.0, 0.0)

    def switch(self, part: str | None) -> None:
        """Add the time from now on to ``part``: "collecting", "updating" or "validating"; None stops the watch."""
        at = time.monotonic(), processor_seconds()
        if self._part is not None:
            values = self._parts.setdefault(self._part, {"wall_s": 0.0, "processor_s": 0.0})
            values["wall_s"] += at[0] - self._began[0]
            values["processor_s"] += max(0.0, at[1] - self._began[1])
        self._part, self._began = part, at

    def count(self, part: str, steps: int) -> None:
        """Add ``steps`` (environment steps, or states used for training) to the count of ``part``."""
        values = self._parts.setdefault(part, {"wall_s": 0.0, "processor_s": 0.0})
        values["steps"] = int(values.get("steps", 0)) + steps

    def save(self) -> None:
        """Write the times to the file, without stopping the watch."""
        self.switch(self._part)
        parts = {}
        for name, values in self._parts.items():
            parts[name] = {key: round(value, 2) for key, value in values.items() if key != "steps_per_s"}
            if "steps" in values and values["wall_s"] > 0:
                parts[name]["steps_per_s"] = round(values["steps"] / values["wall_s"], 2)
        total = {key: round(sum(values[key] for values in parts.values()), 2) for key in ("wall_s", "processor_s")}
        hardware = machine.hardware()
        write_json(self._file, {"sittings": self._sittings, "parts": parts, "total": total, "hardware": hardware})
