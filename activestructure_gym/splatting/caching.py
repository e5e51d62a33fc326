"""numba's on-disk cache for kernels that call into another file.

numba forgets a cached kernel when the file it stands in changes, but not when a file whose functions it uses does. The
values of a kernel's closure are part of its key, however. So every such kernel is made by a factory that takes
``stamp_of(the other modules)`` and mentions the stamp in the kernel's body: other sources, other key, new compilation.
"""

from __future__ import annotations

import hashlib
import inspect
from types import ModuleType


def stamp_of(*modules: ModuleType) -> int:
    """A number (56 bits) that changes with the source of any of the modules."""
    digest = hashlib.sha256()
    for module in modules:
        try:
            source = inspect.getsource(module)
        except OSError:  # installed without sources: then they cannot change under the cache either
            source = module.__name__
        digest.update(source.encode())
    return int.from_bytes(digest.digest()[:7], "little")
