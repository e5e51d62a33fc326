"""Convert texts for the page: shorten absolute paths, and compress markup that the page shows on demand."""

from __future__ import annotations

import base64
import json
import re
import zlib
from collections.abc import Iterable

_NAME = r"[^\s/\\'\"`?&,;:|()<>]+"
# An absolute path, from the root, a home directory or a drive. Units such as m/s and web addresses do not match.
_ABSOLUTE = re.compile(rf"(?<![\w.~/\\])(?:~|[A-Za-z]:(?=[\\/]))?[\\/](?:{_NAME}[\\/]+)*({_NAME})[\\/]*")


def without_folders(text: str) -> str:
    """Replace every absolute path in a text by its last component, since reports are sent to others."""
    return _ABSOLUTE.sub(r"\1", text)


def compressed(texts: Iterable[str]) -> str:
    """Return texts as a JSON list, compressed by zlib (RFC 1950) and encoded in base64, for an HTML attribute.

    The script of the page unpacks it by `DecompressionStream("deflate")`.
    """
    return base64.b64encode(zlib.compress(json.dumps(list(texts), ensure_ascii=False).encode(), 9)).decode("ascii")
