"""The command ``asg``: compare policies, look at scenes, see what works here."""

from __future__ import annotations

import errno
import faulthandler
import os
import signal
import sys
import threading
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from types import FrameType
from typing import Any, NoReturn

from activestructure_gym.errors import FullDisk, InputError, InputWarning, one_line, short_repr
from activestructure_gym.evaluation.machine.threads import set_passive_waiting
from activestructure_gym.streams import FULL, complain, kept_streams, say

_STOPPED, _TERMINATED = 130, 128 + signal.SIGTERM  # exit codes
_NOT_WRITABLE = (*FULL, errno.EROFS)
_MIN_ADDRESS_SPACE = 1_200_000_000  # bytes; with less, libraries end the process by a fault or never return


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return the exit code.

    0 done, 1 some of it failed, 2 wrong input, 130 stopped with Ctrl-C, 143 stopped with SIGTERM. What reads standard
    output, and in which encoding, changes nothing of it; only a file on a full disk does.
    """
    arguments = list(sys.argv[1:] if argv is None else argv)
    with kept_streams() as (out, _):
        code = _answered(arguments)
        out.flush()
        if out.failure is not None:
            out.drop()
            complain(f"standard output cannot be written: {out.failure.strerror}")
            return code or 1
    return code


def _answered(arguments: Sequence[str]) -> int:
    if not arguments or arguments[0] in ("-h", "--help") or arguments == ["help"]:
        from activestructure_gym.evaluation.cli.commands import help_text

        say(help_text())
        return 0
    if arguments[0] in ("-V", "--version"):
        from activestructure_gym._version import __version__

        say(f"activestructure-gym {__version__}")
        return 0
    set_passive_waiting()
    if not faulthandler.is_enabled():
        with suppress(AttributeError, OSError, ValueError):  # there is no standard error
            faulthandler.enable()
    with _sigterm_as_ctrl_c() as terminated:
        code = _exit_code(arguments)
    return _TERMINATED if terminated and code == _STOPPED else code


def _exit_code(arguments: Sequence[str]) -> int:
    """Run a command; its exit code, with every expected error printed as one line on standard error."""
    try:
        _check_address_space()
        _find_in_working_directory()
        with _doubts_as_lines():
            return _run(arguments)
    except InputError as error:
        complain(str(error))
        return 1 if isinstance(error, FullDisk) else 2
    except KeyboardInterrupt:
        complain("stopped")
        return _STOPPED
    except SystemExit as end:  # the commands raise none
        complain(f"a policy, a feature or a scene ended the program (exit code {end.code})")
        return 1
    except OSError as error:
        if error.errno not in _NOT_WRITABLE and error.filename is None:
            raise
        where = "a file" if error.filename is None else short_repr(error.filename)
        what = " cannot be written" if error.errno in _NOT_WRITABLE else ""
        complain(f"{where}{what}: {error.strerror}")
        return 1 if error.errno in _NOT_WRITABLE else 2


def _check_address_space() -> None:
    """Raise `InputError` where this process may not have the address space that every command needs."""
    try:
        import resource
    except ImportError:  # Windows
        return
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    if 0 <= limit < _MIN_ADDRESS_SPACE:
        raise InputError(
            f"the address space is limited to {limit / 1e9:.1f} GB (ulimit -v), and a run needs about 2 GB: "
            "raise the limit"
        )


def _find_in_working_directory() -> None:
    """Let modules of the working directory be imported, behind all installed packages."""
    try:
        here = os.getcwd()
    except FileNotFoundError:  # deleted meanwhile
        raise InputError("the working directory does not exist any more; change into another one") from None
    if here not in sys.path and "" not in sys.path:
        sys.path.append(here)


@contextmanager
def _sigterm_as_ctrl_c() -> Iterator[list[int]]:
    """While the block runs SIGTERM raises KeyboardInterrupt; yields a list that then holds the signal's number."""
    came: list[int] = []

    def stop(number: int, frame: FrameType | None) -> NoReturn:
        came.append(number)
        raise KeyboardInterrupt

    if threading.current_thread() is not threading.main_thread() or signal.getsignal(signal.SIGTERM) != signal.SIG_DFL:
        yield came  # somebody else's to decide
        return
    signal.signal(signal.SIGTERM, stop)
    try:
        yield came
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


@contextmanager
def _doubts_as_lines() -> Iterator[None]:
    """While the block runs, print every `InputWarning` once and as one line, without its place in the code."""
    told: set[str] = set()

    def show(message: Warning | str, category: type[Warning], *place: Any, **more: Any) -> None:
        if not issubclass(category, InputWarning):
            usual(one_line(str(message)), category, *place, **more)
        elif str(message) not in told:
            told.add(str(message))
            complain(f"note: {message}")

    with warnings.catch_warnings():
        warnings.simplefilter("always", InputWarning)
        usual, warnings.showwarning = warnings.showwarning, show
        yield


def _run(arguments: Sequence[str]) -> int:
    from activestructure_gym.evaluation.cli.commands import find_command

    name, *rest = arguments
    if name == "help":
        name, rest = rest[0], [*rest[1:], "--help"]
    kind = find_command(name)

    from activestructure_gym.evaluation.cli.parsing import parse

    try:
        command = parse(kind, name, rest)
    except SystemExit as end:  # after help, or after a message of tyro
        return int(end.code or 0)
    return command.run()
