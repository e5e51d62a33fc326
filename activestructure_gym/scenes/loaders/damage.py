"""Describe damage of mesh files in messages with a remedy."""

from __future__ import annotations

import binascii
import json
import struct
import zlib
from xml.etree import ElementTree


class UnreadableMesh(ValueError):
    """Report a damaged file; the message ends a sentence: "it is cut off", "its nodes form a loop"."""


# Parts of Python's and numpy's messages for text that is not a number.
_NO_NUMBER = ("invalid literal for int", "could not convert string", "unmatched data")


def in_words(error: Exception) -> str:
    """Return the cause of an exception in a reader, as the end of a sentence about the file, with a remedy."""
    if isinstance(error, UnreadableMesh):
        reason = str(error)
    elif isinstance(error, json.JSONDecodeError):
        reason = f"its JSON is damaged at line {error.lineno}, column {error.colno}"
    elif isinstance(error, ElementTree.ParseError):
        reason = "its XML is damaged at line {}, column {}".format(*error.position)
    elif isinstance(error, UnicodeDecodeError):
        reason = "its text is not in UTF-8; save it so"
    elif isinstance(error, RecursionError):
        reason = "its entries are nested too deeply"
    elif isinstance(error, KeyError) and error.args and isinstance(error.args[0], str):
        reason = f"an entry in it lacks '{error.args[0][:60]}'; export it again"
    elif isinstance(error, IndexError):
        reason = "it refers to an entry that does not exist; export it again"
    elif isinstance(error, struct.error | EOFError | zlib.error | binascii.Error):
        reason = "it is cut off or damaged; copy or export it again"
    elif isinstance(error, ValueError) and any(words in str(error) for words in _NO_NUMBER):
        reason = "it has other text where numbers are expected (with points, no commas); export it again"
    elif isinstance(error, OSError) and error.strerror:
        reason = f"it cannot be opened ({error.strerror})"
    else:
        reason = "its content is damaged or not what the format says; export it again"
    return " ".join(reason.split())
