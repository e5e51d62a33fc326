"""Compile ahead: helper processes compile the kernels of a first episode while this process loads or computes.

``first_kernels.txt`` lists the kernels with the types of their arguments, in the order of their first use. This process
compiles them in that order. Helpers start at the end of the list and skip a kernel that another process compiles. They
leave only cache files and end with their parent. ``ASG_COMPILE_AHEAD=0`` in the environment switches them off.
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
_helpers: list[subprocess.Popen[bytes] | None] = []  # a process starts them once


class ListedKernel(NamedTuple):
    """Identify one kernel of the list and the types of its arguments."""

    module: str
    function: str
    arguments: str

    def is_kept(self) -> bool:
        """Return whether its machine code is on disk, valid and undamaged; True where none can be kept."""
        kernel = getattr(import_module(self.module), self.function)
        holds = getattr(getattr(kernel, "_cache", None), "holds", None)
        return holds is None or bool(holds(signature_of(self.arguments), kernel.targetctx.codegen()))

    def compile(self) -> None:
        """Compile it, or load it where it is on disk."""
        getattr(import_module(self.module), self.function).compile(signature_of(self.arguments))


def listed_kernels(features: Collection[str] = ()) -> list[ListedKernel]:
    """Return the kernels of the list, in its order; those of features only if ``features`` names their module."""
    text = Path(__file__).with_name("first_kernels.txt").read_text(encoding="utf-8")
    rows = re.findall(r"^([\w.]+):(\w+)\((.*)\)$", text, re.MULTILINE)
    listed = [ListedKernel(f"{_PACKAGE}.{module}", function, arguments) for module, function, arguments in rows]
    return [each for each in listed if "features" not in each.module or each.module in features]


def signature_of(text: str) -> tuple[Any, ...]:
    """Return numba's types for the arguments of a line; a named tuple is written ``module:Class(fields)``."""

    def whole(given: Any, kind: Any = None) -> Any:
        return types.BaseTuple.from_types(tuple(map(whole, given)), kind) if isinstance(given, tuple) else given

    def named(module: str, name: str, *fields: Any) -> Any:
        return whole(fields, getattr(import_module(f"{_PACKAGE}.{module}"), name))

    called = re.sub(r"([\w.]+):(\w+)\(", r"named('\1', '\2', ", text)
    return tuple(map(whole, eval(f"({called},)", {**vars(types), "bool": types.boolean, "named": named})))


def start_helpers(kernels: Sequence[ListedKernel] = ()) -> None:
    """Start processes that compile these kernels, unless they cannot help or another process has started some.

    By default these are the listed kernels of the modules that this process has loaded, without those of features.
    """
    if _helpers:
        return
    _helpers.append(None)
    an_interpreter = Path(sys.executable or "").name.startswith("python") and not getattr(sys, "frozen", False)
    useless = os.environ.get(SWITCH) == "0" or not an_interpreter or bool(files.not_kept)
    if useless or multiprocessing.parent_process() is not None or LOCKS.is_held("helper 0") or not LOCKS.usable:
        return
    wanted = json.dumps(kernels or [each for each in listed_kernels() if each.module in sys.modules])
    path = os.pathsep.join(os.path.abspath(entry) for entry in sys.path)  # they find modules where their parent does
    for number in range(min(core_count() - 1, MAX_HELPERS)):
        with suppress(OSError):  # no more processes allowed
            helper = subprocess.Popen(
                [sys.executable, "-P", "-c", f"from {__name__} import main; main({number})", wanted],
                env={**os.environ, "PYTHONPATH": path},
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                start_new_session=True,  # Ctrl-C reaches it through the end of its parent
            )
            _helpers.append(helper)  # keeps standard input open: a helper ends when that is closed


def main(number: int) -> None:
    """Compile the kernels in the JSON list ``sys.argv[1]``, last one first; end when standard input is closed."""
    kernels = [ListedKernel(*row) for row in json.loads(sys.argv[1])]
    threading.Thread(target=_end_with_parent, daemon=True).start()
    if LOCKS.take(f"helper {number}") and LOCKS.usable:
        with told_to(lambda name: None):
            for each in reversed(kernels):
                if not LOCKS.is_held(f"{each.module}.{each.function}"):
                    each.compile()


def _end_with_parent() -> None:
    sys.stdin.read()
    _thread.interrupt_main()  # temporary files are removed
    time.sleep(5.0)  # s; enough unless the main thread hangs
    os._exit(1)
