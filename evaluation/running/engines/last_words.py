"""The sentence about a worker process that ended without a result, from its exit code and its log."""

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


def last_words(log: Path, start: int, code: int) -> str:
    """Why a process with this exit code left no result; its log begins at byte ``start``."""
    text = log.read_bytes()[start:].decode("utf-8", errors="replace")
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    last = one_line(lines[-1]) if lines else ""  # a policy's exception may say anything
    if code < 0:
        return f"{_place_of_fault(lines) or last or 'the worker wrote nothing'} ({_signal(-code)})"
    if code == 0 or re.match(r"SystemExit\b", last):
        return ended_by_its_code(code)
    if is_memory_error(last):
        last = f"{last} ({_NO_MEMORY})"
    return f"{last or 'the worker wrote nothing'} (exit code {code})"


def ended_by_its_code(code: object) -> str:
    """The sentence about a process that a policy, a feature or a scene has ended, as with ``sys.exit``."""
    return f"the policy ended the process (exit code {0 if code is None else code}) before the run was done"


def error_words(error: BaseException) -> str:
    """The sentence about an exception of a run in this process."""
    if isinstance(error, SystemExit):
        return ended_by_its_code(error.code)
    words = one_line(f"{type(error).__name__}: {error}".removesuffix(": "))
    return f"{words} ({_NO_MEMORY})" if isinstance(error, MemoryError) else words


def is_memory_error(line: str) -> bool:
    """Whether the last line of a traceback says that memory ran out."""
    return bool(re.match(r"([\w.]*\b_?(Array)?MemoryError\b|std::bad_alloc|OpenBLAS error: Memory allocation)", line))


def _signal(number: int) -> str:
    try:
        name = signal.Signals(number).name
    except ValueError:
        return f"killed by signal {number}"
    reason = _REASONS.get(name)
    return f"killed by signal {number}, {name}{f': {reason}' if reason else ''}"


def _place_of_fault(lines: list[str]) -> str:
    """The fault and the line of Python it happened in, where Python's fault handler has written them."""
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
