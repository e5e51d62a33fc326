"""Wrap standard streams so that writing to them never raises an error.

A stream may be missing, closed, full, or without a character of the text. All output of the command line and of the
package goes through this module. Control characters in texts from files and other programs are escaped before they
reach a terminal.
"""

from __future__ import annotations

import codecs
import errno
import io
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

from activestructure_gym.errors import one_line, printable

# Error numbers for no space left: a full disk, a quota, a file size limit.
FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
# ASCII replacements for characters that an encoding lacks.
_SIGNS = {
    "✓": "ok", "✗": "failed", "↻": "again", "→": "->", "←": "<-", "↑": "up", "↓": "down", "±": "+-", "·": "-",
    "•": "*", "≈": "~", "≤": "<=", "≥": ">=", "−": "-", "–": "-", "—": "-", "×": "x", "…": "...", "²": "2", "³": "3",
    "°": "deg", "µ": "u", "γ": "gamma", "‘": "'", "’": "'", "“": '"', "”": '"', "█": "#", "│": "|", "║": "|", "┃": "|",
    "─": "-", "═": "-", "━": "-", "╸": "-", "╺": "-",
}  # fmt: skip
_FRAMES = range(0x2500, 0x2580)  # box-drawing characters; those without an entry above become "+"
_SPINNER = range(0x2800, 0x2900)


def fitting(text: str, encoding: str, errors: str = "strict") -> str:
    """Return the text with replacements for the characters that ``encoding`` lacks.

    Some characters have ASCII replacements, such as "->" for an arrow. The others are handled by ``errors``, a handler
    of Python's codecs. "strict", "surrogateescape" and "surrogatepass" replace them by a question mark.
    """
    if text.isascii() or _has(encoding, text):
        return text
    try:
        codecs.lookup(encoding)
    except LookupError:
        encoding = "ascii"
    text = "".join(c if _has(encoding, c) else _sign(c) for c in text)
    handler = "replace" if errors in ("strict", "surrogateescape", "surrogatepass") else errors
    return text.encode(encoding, handler).decode(encoding, "replace")


def _has(encoding: str, text: str) -> bool:
    try:
        text.encode(encoding)
    except (UnicodeError, LookupError):
        return False
    return True


def _sign(character: str) -> str:
    if ord(character) in _SPINNER:
        return "*"
    return _SIGNS.get(character, "+" if ord(character) in _FRAMES else character)


class Stream(io.TextIOBase):
    """Wrap a text stream that may be None, closed, full, or a pipe whose reader has ended.

    Writing never raises an error; text that cannot be written is dropped. After an error of a full disk, ``failure`` is
    that error.
    """

    def __init__(self, below: Any) -> None:
        self.below = below
        self.failure: OSError | None = None
        self._gone = below is None

    @property
    def encoding(self) -> str:  # type: ignore[override]
        """Return the encoding of the wrapped stream."""
        return str(getattr(self.below, "encoding", None) or "utf-8")

    @property
    def errors(self) -> str:  # type: ignore[override]
        """Return the wrapped stream's handler for characters that its encoding lacks."""
        return str(getattr(self.below, "errors", None) or "strict")

    def write(self, text: str) -> int:
        """Write the text, with replacements for characters that the stream's encoding lacks; return its length."""
        with self._going_on():
            if not self._gone:
                try:
                    self.below.write(fitting(text, self.encoding, self.errors))
                except UnicodeEncodeError:  # the stream does not report its real encoding
                    self.below.write(fitting(text, "ascii"))
        return len(text)

    def flush(self) -> None:
        """Flush the wrapped stream."""
        with self._going_on():
            if not self._gone and hasattr(self.below, "flush"):
                self.below.flush()

    def close(self) -> None:
        """Flush the wrapped stream but do not close it, because it belongs to its creator."""
        self.flush()

    def writable(self) -> bool:
        """Return True, as required of a text stream."""
        return True

    def isatty(self) -> bool:
        """Return whether the wrapped stream is a terminal."""
        with suppress(OSError, ValueError, AttributeError):
            return not self._gone and bool(self.below.isatty())
        return False

    def fileno(self) -> int:
        """Return the file descriptor of the wrapped stream."""
        if not hasattr(self.below, "fileno"):
            raise io.UnsupportedOperation("fileno")
        return int(self.below.fileno())

    def __getattr__(self, name: str) -> Any:
        if name == "below":  # during copying, before the attributes are set
            raise AttributeError(name)
        return getattr(self.below, name)

    @contextmanager
    def _going_on(self) -> Iterator[None]:
        try:
            yield
        except BlockingIOError:  # a pipe that is full at the moment
            pass
        except (OSError, ValueError) as error:  # ValueError: the stream has been closed
            if isinstance(error, OSError) and error.errno in FULL:
                self.failure = error
            else:
                self.drop()

    def drop(self) -> None:
        """Stop writing to the wrapped stream. If it is standard output or error, redirect it to the null device.

        Without the redirection the interpreter would flush the stream's buffer at exit and fail.
        """
        self._gone = True
        if self.below is not None and self.below in (sys.__stdout__, sys.__stderr__):
            with suppress(OSError, ValueError):
                null = os.open(os.devnull, os.O_WRONLY)
                os.dup2(null, self.below.fileno())
                os.close(null)


class Plain(Stream):
    """Write text with control characters escaped.

    ``raw`` is the wrapped stream; it accepts the terminal codes of this program.
    """

    def __init__(self, below: Any) -> None:
        self.raw = below if isinstance(below, Stream) else Stream(below)
        super().__init__(self.raw)

    def write(self, text: str) -> int:
        """Write the text with control characters escaped; return its length."""
        self.raw.write(printable(text))
        return len(text)


@contextmanager
def kept_streams() -> Iterator[tuple[Stream, Stream]]:
    """Replace standard output and standard error by `Plain` streams during the block.

    Yields the ``raw`` streams of both.
    """
    before = sys.stdout, sys.stderr
    _occupy_descriptors()
    out, err = Plain(before[0]), Plain(before[1])
    sys.stdout, sys.stderr = out, err
    try:
        yield out.raw, err.raw
    finally:
        out.flush()
        err.flush()
        if (sys.stdout, sys.stderr) == (out, err):
            sys.stdout, sys.stderr = before


def _occupy_descriptors() -> None:
    """Open the null device in place of closed standard streams (file descriptors 0 to 2).

    Otherwise the next opened files would get these descriptors, and the output of libraries and child processes would
    be written into those files.
    """
    with suppress(OSError):
        while (descriptor := os.open(os.devnull, os.O_RDWR)) < 3:
            os.set_inheritable(descriptor, True)
        os.close(descriptor)


def raw(stream: Any) -> Any:
    """Return the stream that accepts terminal codes: the one below a `Plain` stream, otherwise ``stream`` itself."""
    return stream.raw if isinstance(stream, Plain) else stream


def lowest(stream: Any) -> Any:
    """Return the innermost stream, without the wrappers of this module."""
    while isinstance(stream, Stream):
        stream = stream.below
    return stream


def say(text: str = "") -> None:
    """Write a text of one or more lines, and a line end, to standard output."""
    write_line(sys.stdout, text)


def complain(text: str) -> None:
    """Write the text as one line that begins with ``asg:`` to standard error."""
    write_line(sys.stderr, f"asg: {one_line(text)}")


def write_line(stream: Any, text: str) -> None:
    """Write a text and a line end to a stream, with control characters escaped and without raising errors."""
    stream = stream if isinstance(stream, Plain) else Plain(stream)
    stream.write(f"{text}\n")
    stream.flush()


def flat(text: str) -> str:
    """Return a text from outside this program as one printable line of any length."""
    return printable(text).replace("\n", " ")


def escape(text: str) -> str:
    """Return a text from outside this program as one printable line, with the markup of the library rich escaped."""
    from rich.markup import escape as without_markup

    return without_markup(flat(text))
