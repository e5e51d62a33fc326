"""Links out of the folder of the docs, as to an example, which the site cannot follow, as the names of files."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

DOCS = Path(__file__).resolve().parents[1]
_LINK = re.compile(r"(?<!!)\[([^\]]+)\]\(([^)#\s]+)(#[^)\s]*)?\)")


def outside_links(app: Any, name: str, source: list[str]) -> None:
    """Replace links to files of the repository that are no pages by their text, as Sphinx reads a page."""
    folder = (DOCS / name).parent

    def replaced(found: re.Match[str]) -> str:
        text, target, _ = found.groups()
        if "://" in target or target.startswith("mailto:"):
            return found[0]
        path = (folder / target).resolve()
        outside = DOCS not in path.parents
        if outside and not path.exists():
            return found[0]  # which Sphinx will call missing
        return text if outside else found[0]

    source[0] = _LINK.sub(replaced, source[0])
