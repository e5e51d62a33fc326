"""Make pages of the documentation site from the code: environments, policies, commands and the reference.

The pages are written to ``docs/_made``, which git ignores, before the site is built. Unchanged pages are not written
again, so Sphinx does not read them again.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

MADE = Path(__file__).parents[1] / "_made"


def setup(app: Any) -> dict[str, bool]:
    """Register the handlers of this package with Sphinx, such that pages are made before Sphinx lists its sources."""
    from _site.links import named_links, outside_links
    from _site.reference import link_to_entry
    from _site.shapes import add_shapes

    app.connect("config-inited", lambda app, config: make_pages())
    app.connect("source-read", outside_links)
    app.connect("source-read", named_links)
    app.connect("autodoc-process-docstring", _bars)
    app.connect("autodoc-process-docstring", add_shapes)
    app.connect("missing-reference", link_to_entry)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def _bars(app: Any, what: str, name: str, thing: Any, options: Any, lines: list[str]) -> None:
    """Escape bars such as in |P_i| in the lines of a docstring, since reStructuredText uses bars for substitutions."""
    lines[:] = [re.sub(r"(?<!\\)\|", r"\\|", line) if "``" not in line else line for line in lines]


def make_pages() -> None:
    """Write all pages that are made from the code, and remove pages that are no longer made."""
    from _site import about, commands, configuration, environments, policies, reference

    pages = environments.pages(MADE)
    for made in (about, commands, configuration, policies, reference):
        pages |= made.pages()
    for old in MADE.rglob("*.md"):
        if str(old.relative_to(MADE)) not in pages:
            old.unlink()
    for name, text in pages.items():
        write(MADE / name, text)


def write(path: Path, text: str) -> None:
    """Write ``text`` to the file ``path``, unless the file has this content already."""
    if not path.is_file() or path.read_text(encoding="utf-8") != text:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
