"""Compile kernels ahead of their use: helper processes compile the kernels that the first episode needs.

``first_kernels.txt`` lists the kernels with the types of their arguments, in the order of their first use. The main
process compiles them in that order. Helpers begin at the end of the list and skip kernels that another process
compiles. They only write cache files, and they end when the main process ends. ``ASG_COMPILE_AHEAD=0`` in the
environment disables them.
"""

from __future__ import annotations

import _thread
import json
import multiprocessing
import os
import re
import subprocess
import sys
import threading
import time
from collections.abc import Collection, Sequence
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

from numba import types

from activestructure_gym.compiling import files
from activestructure_gym.compiling.locks import LOCKS
from activestructure_gym.compiling.progress import told_to
from activestructure_gym.cores import core_count

SWITCH = "ASG_COMPILE_AHEAD"
MAX_HELPERS = 3  # each needs about 300 MB of memory
_PACKAGE = __name__.partition(".")[0]
# Started helpers. The list is not empty once this process has tried to start some.
_helpers: list[subprocess.Popen[bytes] | None] = []


class ListedKernel(NamedTuple):
    """Identify one kernel of the list: module, function name, and argument types as in ``first_kernels.txt``."""

    module: str
    function: str
    arguments: str

    def is_kept(self) -> bool:
        """Return whether the kernel's machine code is on disk, valid and undamaged.

        True if kernels cannot be kept on disk.
        """
        kernel = getattr(import_module(self.module), self.function)
        holds = getattr(getattr(kernel, "_cache", None), "holds", None)
        return holds is None or bool(holds(signature_of(self.arguments), kernel.targetctx.codegen()))

    def compile(self) -> None:
        """Compile the kernel, or load its machine code from disk."""
        getattr(import_module(self.module), self.function).compile(signature_of(self.arguments))


def listed_kernels(features: Collection[str] = ()) -> list[ListedKernel]:
    """Return the kernels of ``first_kernels.txt`` in order.

    Kernels of a feature only if ``features`` names its module.
    """
    text = Path(__file__).with_name("first_kernels.txt").read_text(encoding="utf-8")
    rows = re.findall(r"^([\w.]+):(\w+)\((.*)\)$", text, re.MULTILINE)
    listed = [ListedKernel(f"{_PACKAGE}.{module}", function, arguments) for module, function, arguments in rows]
    return [each for each in listed if "features" not in each.module or each.module in features]


def signature_of(text: str) -> tuple[Any, ...]:
    """Convert the argument types of one line of ``first_kernels.txt`` to numba types.

    A named tuple is written ``module:Class(fields)``.
    """

    def whole(given: Any, kind: Any = None) -> Any:
        return types.BaseTuple.from_types(tuple(map(whole, given)), kind) if isinstance(given, tuple) else given

    def named(module: str, name: str, *fields: Any) -> Any:
        return whole(fields, getattr(import_module(f"{_PACKAGE}.{module}"), name))

    called = re.sub(r"([\w.]+):(\w+)\(", r"named('\1', '\2', ", text)
    return tuple(map(whole, eval(f"({called},)", {**vars(types), "bool": types.boolean, "named": named})))


def start_helpers(kernels: Sequence[ListedKernel] = ()) -> None:
    """Start helper processes that compile ``kernels``, unless helpers are disabled, useless or already running.

    The default is the listed kernels of all loaded modules, without kernels of features.
    """
    if _helpers:
        return
    _helpers.append(None)
    an_interpreter = Path(sys.executable or "").name.startswith("python") and not getattr(sys, "frozen", False)
    useless = os.environ.get(SWITCH) == "0" or not an_interpreter or bool(files.not_kept)
    if useless or multiprocessing.parent_process() is not None or LOCKS.is_held("helper 0") or not LOCKS.usable:
        return
    wanted = json.dumps(kernels or [each for each in listed_kernels() if each.module in sys.modules])
    # Helpers find modules in the same folders as this process.
    path = os.pathsep.join(os.path.abspath(entry) for entry in sys.path)
    for number in range(min(core_count() - 1, MAX_HELPERS)):
        with suppress(OSError):  # the system allows no more processes
            helper = subprocess.Popen(
                [sys.executable, "-P", "-c", f"from {__name__} import main; main({number})", wanted],
                env={**os.environ, "PYTHONPATH": path},
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                start_new_session=True,  # Ctrl-C does not reach the helper, which ends with its parent instead
            )
            _helpers.append(helper)  # keeps the helper's standard input open; the helper ends when it is closed


def main(number: int) -> None:
    """Run helper process ``number``: compile the kernels in the JSON list ``sys.argv[1]``, last one first.

    The process ends when its standard input is closed.
    """
    kernels = [ListedKernel(*row) for row in json.loads(sys.argv[1])]
    threading.Thread(target=_end_with_parent, daemon=True).start()
    if LOCKS.take(f"helper {number}") and LOCKS.usable:
        with told_to(lambda name: None):
            for each in reversed(kernels):
                if not LOCKS.is_held(f"{each.module}.{each.function}"):
                    each.compile()


def _end_with_parent() -> None:
    sys.stdin.read()
    _thread.interrupt_main()  # an exception in the main thread, so that temporary files are removed
    time.sleep(5.0)  # seconds; the main thread has ended by then unless it hangs
    os._exit(1)
