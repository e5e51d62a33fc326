"""Remove the folders of absolute paths from texts, since reports are sent to others."""

from __future__ import annotations

import re

_NAME = r"[^\s/\\'\"`?&,;:|()<>]+"
# From the root, from a home directory or from a drive; not a share of two units, and not an address of the web.
_ABSOLUTE = re.compile(rf"(?<![\w.~/\\])(?:~|[A-Za-z]:(?=[\\/]))?[\\/](?:{_NAME}[\\/]+)*({_NAME})[\\/]*")


def without_places(text: str) -> str:
    """``text`` with every absolute path cut down to its last name."""
    return _ABSOLUTE.sub(r"\1", text)
