"""Compute the stamp of a kernel: one hash over the files that its machine code was made from.

numba builds into a kernel what its functions call and every constant that they read, from any file. So a stamp covers
whole files: the kernel's own, each file that it imports, and in turn what those of them import that hold compiled code.
An edit compiles the kernels of its file again, and those of the files that import it. Imports count if they begin a
line, because a kernel cannot use a later import. Installed packages of others count by their versions (`files`).
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

_BEGAN = time.time()  # a file that has changed since then may differ from the code of this process
_OURS = __name__.partition(".")[0]
_ROOM = __name__.rpartition(".")[0]
_COMMENT = re.compile(r"#.*")
_IMPORT = re.compile(r"^(?:from\s+([\w.]+)\s+import\s+(\([^)]*\)|.*)|import\s+([\w.]+))", re.MULTILINE)
_COMPILED = re.compile(r"\b(numba|njit|kernel|inline|intrinsic)\b")  # too many files are better than too few


def stamp_of(function: FunctionType) -> bytes | None:  # 32 bytes
    """Return the stamp of a kernel; None if its machine code must not be kept.

    That is so if it has no file, if one of the files has changed since this process loaded it, or if the kernel reads
    variables of an enclosing function, which are in no file.
    """
    digests = [_read(file)[0] for file in sorted(files_of(function.__code__.co_filename, function.__module__))]
    return hashlib.sha256(b"".join(digests)).digest() if all(digests) and not function.__closure__ else None


@lru_cache(None)
def files_of(first: str, importer: str) -> set[str]:
    """Return the source files that the kernels of a file depend on, where ``importer`` is its module."""
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
    """Yield the loaded modules that the imports of a module name."""
    package = getattr(sys.modules.get(importer), "__package__", None) or ""
    for source, names, plain in imports:
        with suppress(ImportError):  # relative, in a file that was not imported
            module = importlib.util.resolve_name(source or plain, package)
            candidates = (module, *(f"{module}.{name}" for name in re.findall(r"\w+", names)))
            yield from (candidate for candidate in candidates if candidate in sys.modules)


@lru_cache(None)
def _read(file: str) -> tuple[bytes, list[tuple[str, ...]], bool]:
    """Return the digest of a file, its imports, and whether others depend on what it imports.

    The digest is empty where there is no file or it has changed since this process began.
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
