"""Describe in one sentence why a worker process ended without a result, from its exit code and its log."""

from __future__ import annotations

import re
import signal
from pathlib import Path

from activestructure_gym.errors import one_line

_FAULT = "a fault in compiled code, or too little memory or address space (ulimit -v)"
_REASONS = {
    "SIGKILL": "perhaps because memory ran out",
    "SIGTERM": "by another program",
    "SIGXCPU": "its limit of processor time (ulimit -t) was used up",
    "SIGXFSZ": "a file became larger than its limit (ulimit -f)",
} | dict.fromkeys(("SIGSEGV", "SIGBUS", "SIGILL", "SIGFPE", "SIGABRT"), _FAULT)
_NO_MEMORY = "memory ran out: use fewer --workers or a smaller scene"


def failure_text(log: Path, start: int, code: int) -> str:
    """Describe why a process with this exit code has no result; its log begins at byte ``start`` of the file."""
    text = log.read_bytes()[start:].decode("utf-8", errors="replace")
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    last = one_line(lines[-1]) if lines else ""  # a message of a plug-in may contain control characters
    if code < 0:
        return f"{_place_of_fault(lines) or last or 'the worker wrote nothing'} ({_signal(-code)})"
    if code == 0 or re.match(r"SystemExit\b", last):
        return exit_text(code)
    if is_memory_error(last):
        last = f"{last} ({_NO_MEMORY})"
    return f"{last or 'the worker wrote nothing'} (exit code {code})"


def exit_text(code: object) -> str:
    """Describe the end of a process by a policy, a feature or a scene, for example with ``sys.exit``."""
    return f"the policy ended the process (exit code {0 if code is None else code}) before the run was done"


def error_text(error: BaseException) -> str:
    """Describe an exception of a run in this process."""
    if isinstance(error, SystemExit):
        return exit_text(error.code)
    words = one_line(f"{type(error).__name__}: {error}".removesuffix(": "))
    return f"{words} ({_NO_MEMORY})" if isinstance(error, MemoryError) else words


def is_memory_error(line: str) -> bool:
    """Return whether the last line of a traceback is about missing memory."""
    return bool(re.match(r"([\w.]*\b_?(Array)?MemoryError\b|std::bad_alloc|OpenBLAS error: Memory allocation)", line))


def _signal(number: int) -> str:
    """Describe the end of a process by a signal, with the probable reason."""
    try:
        name = signal.Signals(number).name
    except ValueError:
        return f"killed by signal {number}"
    reason = _REASONS.get(name)
    return f"killed by signal {number}, {name}{f': {reason}' if reason else ''}"


def _place_of_fault(lines: list[str]) -> str:
    """Return the fault and its line of Python, if Python's fault handler has written them; else an empty text."""
    for at, line in enumerate(lines):
        if line.startswith("Fatal Python error: "):
            fault = line.removeprefix("Fatal Python error: ")
            after = iter(lines[at:])
            for other in after:
                if other.startswith("Current thread "):
                    where = re.match(r'File "(.*)", line (\d+) in (.*)', next(after, ""))
                    return f"{fault} in {where[3]}, {where[1]}:{where[2]}" if where else fault
            return fault
    return ""
