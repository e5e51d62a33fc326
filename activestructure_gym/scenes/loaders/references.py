"""Find the files that a mesh refers to, however exporters spell them, and nothing else on the disk."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Sequence
from functools import lru_cache
from pathlib import Path
from urllib.parse import unquote

from activestructure_gym.scenes.loaders.budget import LimitError

# Where pictures are kept, as seen from the folder of the mesh: Gazebo's models have meshes/ beside materials/textures/.
PICTURE_FOLDERS = ("textures", "materials/textures", "../textures", "../materials/textures")

_COMMENT = re.compile(r"\s+#")  # behind a name in an OBJ or MTL file; a name may hold it too


def find_reference(base: Path, reference: str, *, climb: int = 1, folders: Sequence[str] = ()) -> Path:
    """Return the file a mesh in ``base`` refers to: relative to that folder, ``../`` and absolute paths included.

    Exporters write percent escapes, backslashes, ``file://``, options or a comment around the name (OBJ), or the path
    on the author's disk. After the path as it is written come the bare file name in ``base`` and in ``folders``, and
    at last names that differ in upper and lower case. Nothing is opened outside the folder ``climb`` levels above the
    mesh: models come as ``meshes/`` beside ``textures/``, and a file of a stranger has no business anywhere else.
    Symbolic links are followed, as data stores are full of them. Raises FileNotFoundError.
    """
    name = reference.strip().strip('"')
    spellings = [reference, name, unquote(name), _COMMENT.split(name)[0]]
    spellings += name.split()[-1:] if name.startswith("-") else []  # an option that no specification has
    spellings += [spelling.replace("\\", "/") for spelling in spellings]
    spellings = list(dict.fromkeys(s.removeprefix("file://").removeprefix("./") for s in spellings))
    names = list(dict.fromkeys(Path(spelling).name for spelling in spellings))
    candidates = [base / spelling for spelling in spellings]
    candidates += [base / folder / name for folder in (".", *folders) for name in names if name]
    absolute = Path(os.path.abspath(base))
    root = absolute.parents[climb - 1] if 0 < climb < len(absolute.parents) else absolute  # never the whole disk
    outside = False
    for candidate in (*candidates, *_in_other_case(candidates, root)):
        inside = Path(os.path.abspath(candidate)).is_relative_to(root)
        try:
            if candidate.is_file():
                if inside:
                    return candidate
                outside = True
        except OSError:  # a name that no file can have
            continue
    if outside:
        raise LimitError(f"lies outside of '{root}'; put it into the folder of the mesh")
    raise FileNotFoundError(f"'{reference}' is not beside '{base}'")


def _in_other_case(candidates: Sequence[Path], root: Path) -> Iterator[Path]:
    """Paths under ``root`` that differ from a candidate in upper and lower case only, as Windows takes them."""
    for candidate in candidates:
        path = Path(os.path.abspath(candidate))
        if not path.is_relative_to(root):
            continue
        found = root
        for part in path.relative_to(root).parts:
            found = found / (part if os.path.exists(found / part) else _entries(found).get(part.casefold(), part))
        yield found


def _entries(folder: Path) -> dict[str, str]:
    try:
        return _listed(str(folder), os.stat(folder).st_mtime_ns)
    except (OSError, ValueError):  # no folder, or no name that one can have
        return {}


@lru_cache(maxsize=16)
def _listed(folder: str, changed: int) -> dict[str, str]:
    """The names in a folder by their small letters; of several the first in the order of the alphabet."""
    return {name.casefold(): name for name in sorted(os.listdir(folder), reverse=True)}
