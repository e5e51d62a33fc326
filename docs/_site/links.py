"""Adapt the links of pages to the site, and summarise the result of Sphinx's link check.

python -m _site.links ../build/links/output.json    # summarise the result of docs/build --links

Links to files outside docs/ become text. In the bibliography, arXiv numbers and names of repositories become links.
"""

from __future__ import annotations

import json
import re
import sys
from collections import Counter
from pathlib import Path
from typing import Any

DOCS = Path(__file__).resolve().parents[1]
_PAPER = re.compile(r"arXiv\s+(\d{4}\.\d{5})")
_PROGRAM = re.compile(r"(Code:\s+)`([\w.-]+/[\w.-]+)`")
_LINK = re.compile(r"(?<!!)\[([^\]]+)\]\(([^)#\s]+)(#[^)\s]*)?\)")


def outside_links(app: Any, name: str, source: list[str]) -> None:
    """Replace links to files outside docs/ by their text in ``source[0]``; Sphinx calls this for the page ``name``."""
    folder = (DOCS / name).parent

    def replaced(found: re.Match[str]) -> str:
        text, target, _ = found.groups()
        if "://" in target or target.startswith("mailto:"):
            return found[0]
        path = (folder / target).resolve()
        outside = DOCS not in path.parents
        if outside and not path.exists():
            return found[0]  # Sphinx reports it as missing
        return text if outside else found[0]

    source[0] = _LINK.sub(replaced, source[0])


def named_links(app: Any, name: str, source: list[str]) -> None:
    """Turn arXiv numbers and names of repositories into links in ``source[0]``, if ``name`` is "references"."""
    if name == "references":
        text = _PAPER.sub(r"[arXiv \1](https://arxiv.org/abs/\1)", source[0])
        source[0] = _PROGRAM.sub(r"\1[`\2`](https://github.com/\2)", text)


def summary(lines: list[str]) -> tuple[str, bool]:
    """Summarise the lines of ``output.json`` of Sphinx's link check as text; return also whether all links work."""
    links = {found["uri"]: found for found in map(json.loads, lines) if found["uri"].startswith(("http:", "https:"))}
    count = Counter(found["status"] for found in links.values())
    answered = count["working"] + count["redirected"]
    silent = [
        f"{uri}: {found['info']}" for uri, found in sorted(links.items()) if found["status"] in ("broken", "timeout")
    ]
    head = f"{len(links)} links to elsewhere: {answered} answered, {len(silent)} did not"
    if rest := len(links) - answered - len(silent):
        head += f", {rest} were not asked"
    return "\n".join([head, *silent]), answered == len(links) > 0


if __name__ == "__main__":
    text, all_answered = summary(Path(sys.argv[1]).read_text(encoding="utf-8").splitlines())
    print(text)
    sys.exit(not all_answered)
