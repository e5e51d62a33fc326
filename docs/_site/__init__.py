"""Pages of the site that are made from the code: environments, policies, and what may be imported.

They are written to ``docs/_made`` before the site is built, which git ignores. A page that has not changed is not
written again, so that a second build reads only what is new.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

MADE = Path(__file__).parents[1] / "_made"


def setup(app: Any) -> dict[str, bool]:
    """Make the pages before Sphinx looks for sources."""
    from _site.links import named_links, outside_links
    from _site.reference import link_to_entry
    from _site.shapes import tell_shapes

    app.connect("config-inited", lambda app, config: make_pages())
    app.connect("source-read", outside_links)
    app.connect("source-read", named_links)
    app.connect("autodoc-process-docstring", _bars)
    app.connect("autodoc-process-docstring", tell_shapes)
    app.connect("missing-reference", link_to_entry)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def _bars(app: Any, what: str, name: str, thing: Any, options: Any, lines: list[str]) -> None:
    """Bars in docstrings are absolute values and sizes, as in |P_i|, and no names of something to put there."""
    lines[:] = [re.sub(r"(?<!\\)\|", r"\\|", line) if "``" not in line else line for line in lines]


def make_pages() -> None:
    """All pages that come from the code; what is no page any more is removed."""
    from _site import environments, gallery, reference

    pages = {**environments.pages(MADE), **gallery.pages(), **reference.pages()}
    for old in MADE.rglob("*.md"):
        if str(old.relative_to(MADE)) not in pages:
            old.unlink()
    for name, text in pages.items():
        write(MADE / name, text)


def write(path: Path, text: str) -> None:
    """Write the file if that changes it."""
    if not path.is_file() or path.read_text(encoding="utf-8") != text:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
