"""Find the files that a mesh refers to, with common misspellings by exporters, and no other files."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from urllib.parse import unquote

from activestructure_gym.scenes.loaders.budget import LimitError

# Image folders relative to the mesh's folder; Gazebo's models have meshes/ and materials/textures/.
PICTURE_FOLDERS = ("textures", "materials/textures", "../textures", "../materials/textures")

_COMMENT = re.compile(r"\s+#")  # after a name in an OBJ or MTL file; a name may contain it too


def find_reference(base: Path, reference: str, *, climb: int = 1, folders: Sequence[str] = ()) -> Path:
    """Return the file that a mesh in ``base`` refers to, relative to that folder, with ``../`` and absolute paths.

    Exporters write percent escapes, backslashes, ``file://``, options or a comment around the name (OBJ), or the path
    on the author's disk. The path as written is tried first, then the file name in ``base`` and ``folders``, then names
    that differ in case. Only files below the folder ``climb`` levels above the mesh are accepted, since models often
    have ``meshes/`` next to ``textures/`` and foreign files must not read elsewhere. Symbolic links are followed; data
    stores use many. Raises FileNotFoundError.
    """
    name = reference.strip().strip('"')
    spellings = [reference, name, unquote(name), _COMMENT.split(name)[0]]
    spellings += name.split()[-1:] if name.startswith("-") else []  # an option outside all specifications
    spellings += [spelling.replace("\\", "/") for spelling in spellings]
    spellings = [s.removeprefix("file://").removeprefix("./") for s in spellings]
    names = dict.fromkeys(os.path.basename(spelling.rstrip("/")) for spelling in spellings)
    spellings += [os.path.join(folder, name) for folder in (".", *folders) for name in names if name]
    candidates = list(dict.fromkeys(os.path.join(base, spelling) for spelling in spellings))
    absolute = Path(os.path.abspath(base))
    root = absolute.parents[climb - 1] if 0 < climb < len(absolute.parents) else absolute  # never the whole disk
    outside = False
    for candidate in candidates:
        if os.path.isfile(candidate):
            if _is_inside(candidate, root):
                return Path(candidate)
            outside = True
    for candidate in candidates:
        found = _in_other_case(candidate, root) if _is_inside(candidate, root) else ""
        if found and os.path.isfile(found):
            return Path(found)
    if outside:
        raise LimitError(f"is outside '{root}'; put it into the folder of the mesh")
    raise FileNotFoundError(f"'{reference}' is not next to '{base}'")


def _is_inside(path: str, root: Path) -> bool:
    return os.path.abspath(path).startswith(os.path.join(root, ""))


def _in_other_case(path: str, root: Path) -> str:
    """Return the existing path under ``root`` that differs from ``path`` only in case; "" if there is none."""
    found = str(root)
    for part in os.path.abspath(path)[len(os.path.join(root, "")) :].split(os.sep):
        entries = _entries(found)
        entry = part if os.path.exists(os.path.join(found, part)) else entries.get(part.casefold())
        if entry is None:
            return ""
        found = os.path.join(found, entry)
    return found


def _entries(folder: str) -> dict[str, str]:
    try:
        return _listed(folder, os.stat(folder).st_mtime_ns)
    except OSError:  # a file, or an unreadable folder
        return {}


@lru_cache(maxsize=16)
def _listed(folder: str, changed: int) -> dict[str, str]:
    """Return the names in a folder by their case-folded form; of several, the first in sorted order.

    ``changed`` is the folder's time of change, so that the cache is renewed when it changes.
    """
    return {name.casefold(): name for name in sorted(os.listdir(folder), reverse=True)}
