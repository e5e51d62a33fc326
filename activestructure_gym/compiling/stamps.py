"""Compute the stamp of a kernel: one hash over all source files from which its machine code was compiled.

numba compiles the functions that a kernel calls, and every constant that they read, into the kernel. So a stamp covers
whole files: the file of the kernel, every file that it imports, and in turn the imports of each of these files that
contains compiled functions. An edit of a file recompiles its kernels and the kernels of all files that import it. Only
imports at the beginning of a line count, because a kernel cannot use a later import. Installed packages are covered by
their versions (`files`).
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
import re
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from functools import lru_cache
from types import FunctionType

_BEGAN = time.time()  # a file changed after this time may differ from the code loaded by this process
_OURS = __name__.partition(".")[0]
_ROOM = __name__.rpartition(".")[0]
_COMMENT = re.compile(r"#.*")
_IMPORT = re.compile(r"^(?:from\s+([\w.]+)\s+import\s+(\([^)]*\)|.*)|import\s+([\w.]+))", re.MULTILINE)
_COMPILED = re.compile(r"\b(numba|njit|kernel|inline|intrinsic)\b")  # an unnecessary file in a stamp is harmless


def stamp_of(function: FunctionType) -> bytes | None:  # 32 bytes
    """Return the stamp of a kernel; None if its machine code must not be kept on disk.

    Machine code must not be kept if the kernel has no source file or one of its files has changed since this process
    loaded it. Nor if the kernel reads variables of an enclosing function, because these are in no file.
    """
    digests = [_read(file)[0] for file in sorted(files_of(function.__code__.co_filename, function.__module__))]
    return hashlib.sha256(b"".join(digests)).digest() if all(digests) and not function.__closure__ else None


@lru_cache(None)
def files_of(first: str, importer: str) -> set[str]:
    """Return the source files that the kernels of the file ``first`` depend on.

    ``importer`` is the module of that file.
    """
    packages, folder = {_OURS, importer.partition(".")[0]}, os.path.dirname(first)
    files, ahead = {first}, [(first, importer)]
    while ahead:
        file, name = ahead.pop()
        _, imports, compiled = _read(file)
        for module in _modules(imports, name) if compiled or file == first else ():
            found = getattr(sys.modules[module], "__file__", None)
            ours = module.partition(".")[0] in packages or os.path.dirname(found or "") == folder
            if found and ours and found not in files and not module.startswith(_ROOM):
                files.add(found)
                ahead.append((found, module))
    return files


def _modules(imports: list[tuple[str, ...]], importer: str) -> Iterator[str]:
    """Yield the names of the loaded modules among ``imports``, the import statements of the module ``importer``."""
    package = getattr(sys.modules.get(importer), "__package__", None) or ""
    for source, names, plain in imports:
        with suppress(ImportError):  # relative, in a file that was not imported
            module = importlib.util.resolve_name(source or plain, package)
            candidates = (module, *(f"{module}.{name}" for name in re.findall(r"\w+", names)))
            yield from (candidate for candidate in candidates if candidate in sys.modules)


@lru_cache(None)
def _read(file: str) -> tuple[bytes, list[tuple[str, ...]], bool]:
    """Return the SHA-256 digest of a file, its import statements, and whether their files belong to the stamp too.

    The digest is empty if the file does not exist or has changed since this process started.
    """
    try:
        with open(file, "rb") as source:
            about, content = os.fstat(source.fileno()), source.read()
    except OSError:
        return b"", [], False
    text = content.decode(errors="replace")
    same = not _BEGAN < max(about.st_mtime, about.st_ctime) <= time.time()
    goes_on = file.endswith("__init__.py") or bool(_COMPILED.search(text))
    return hashlib.sha256(content).digest() if same else b"", _IMPORT.findall(_COMMENT.sub("", text)), goes_on
