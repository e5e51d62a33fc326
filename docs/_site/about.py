"""Make the pages about the project from CHANGELOG.md, CONTRIBUTING.md and CITATION.cff."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]


def pages() -> dict[str, str]:
    """Return the pages by file name; links of the files, relative to the repository, are adapted."""
    cite = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    texts = {
        "changelog": _adapted("CHANGELOG.md"),
        "contributing": _adapted("CONTRIBUTING.md"),
        "cite": f"# Cite\n\nThe file `CITATION.cff` of the repository:\n\n```yaml\n{cite}```\n",
    }
    return {f"about/{name}.md": text for name, text in texts.items()}


def _adapted(name: str) -> str:
    text = (ROOT / name).read_text(encoding="utf-8")
    return re.sub(r"\]\((?!\w+:|#)", "](../../../", text).replace("](../../../docs/", "](../../")
