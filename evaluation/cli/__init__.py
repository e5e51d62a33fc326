"""Run the program ``asg``: parse the arguments, run one command, and print an expected error as one line."""

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

_STOPPED, _TERMINATED = 130, 128 + signal.SIGTERM  # exit codes after Ctrl-C (130) and after SIGTERM (143)
_NOT_WRITABLE = (*FULL, errno.EROFS)  # error numbers of a full disk, and of a file system that is read-only
_MIN_ADDRESS_SPACE = 1_200_000_000  # bytes; with less, libraries crash or hang


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command of ``argv``, by default the arguments of this process, and return the exit code.

    The exit code is 0 for success, 1 if a part of the work failed, 2 for wrong input, 130 after Ctrl-C and 143 after
    SIGTERM. If standard output goes to a full disk, 0 becomes 1. A closed pipe or an encoding without some characters
    does not change the exit code.
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
        with suppress(AttributeError, OSError, ValueError):  # if there is no standard error
            faulthandler.enable()
    with _sigterm_as_ctrl_c() as terminated:
        code = _exit_code(arguments)
    return _TERMINATED if terminated and code == _STOPPED else code


def _exit_code(arguments: Sequence[str]) -> int:
    """Run the command of ``arguments`` and return its exit code; print an expected error as one line on stderr."""
    try:
        _check_address_space()
        _find_in_working_directory()
        with _warnings_as_lines():
            return _run(arguments)
    except InputError as error:
        complain(str(error))
        return 1 if isinstance(error, FullDisk) else 2
    except KeyboardInterrupt:
        complain("stopped")
        return _STOPPED
    except SystemExit as end:  # raised by the code of a plugin; the package does not raise it here
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
    """Raise `InputError` if the process's address space is limited to less than `_MIN_ADDRESS_SPACE`."""
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
    """Append the working directory to ``sys.path``, so the user's policies and scenes in it can be imported."""
    try:
        here = os.getcwd()
    except FileNotFoundError:  # the directory has been deleted
        raise InputError("the working directory does not exist any more; change into another one") from None
    if here not in sys.path and "" not in sys.path:
        sys.path.append(here)


@contextmanager
def _sigterm_as_ctrl_c() -> Iterator[list[int]]:
    """Turn a SIGTERM during the ``with`` block into KeyboardInterrupt, as for Ctrl-C.

    Yield a list to which the number of a received signal is appended.
    """
    received: list[int] = []

    def stop(number: int, frame: FrameType | None) -> NoReturn:
        received.append(number)
        raise KeyboardInterrupt

    if threading.current_thread() is not threading.main_thread() or signal.getsignal(signal.SIGTERM) != signal.SIG_DFL:
        yield received  # another handler is installed, or this thread cannot install a handler
        return
    signal.signal(signal.SIGTERM, stop)
    try:
        yield received
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


@contextmanager
def _warnings_as_lines() -> Iterator[None]:
    """Print every `InputWarning` raised during the ``with`` block once, as one line without its place in the code."""
    printed: set[str] = set()

    def show(message: Warning | str, category: type[Warning], *place: Any, **more: Any) -> None:
        if not issubclass(category, InputWarning):
            original(one_line(str(message)), category, *place, **more)
        elif str(message) not in printed:
            printed.add(str(message))
            complain(f"note: {message}")

    with warnings.catch_warnings():
        warnings.simplefilter("always", InputWarning)
        original, warnings.showwarning = warnings.showwarning, show
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
    except SystemExit as end:  # raised by tyro after it has printed help or an error message
        return int(end.code or 0)
    return command.run()
