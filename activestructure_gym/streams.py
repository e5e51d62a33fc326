"""Standard streams that cannot end a program: one may be missing, end early, or lack characters.

Everything that the command line prints goes through here, and so do the lines that the package itself writes to
standard error. Text of files and of other programs can hold control characters; a terminal never gets them.
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

FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)  # no more room: a full disk, a quota, a limit on the size of files
# Where the encoding of a stream lacks a character, its sign in ASCII.
_SIGNS = {
    "✓": "ok", "✗": "failed", "↻": "again", "→": "->", "←": "<-", "↑": "up", "↓": "down", "±": "+-", "·": "-",
    "•": "*", "≈": "~", "≤": "<=", "≥": ">=", "−": "-", "–": "-", "—": "-", "×": "x", "…": "...", "²": "2", "³": "3",
    "°": "deg", "µ": "u", "γ": "gamma", "‘": "'", "’": "'", "“": '"', "”": '"', "█": "#", "│": "|", "║": "|", "┃": "|",
    "─": "-", "═": "-", "━": "-", "╸": "-", "╺": "-",
}  # fmt: skip
_FRAMES = range(0x2500, 0x2580)  # characters that frames are drawn with: corners and crossings
_SPINNER = range(0x2800, 0x2900)


def fitting(text: str, encoding: str, errors: str = "strict") -> str:
    """Return the text with signs in place of what the encoding lacks; what has no sign is replaced as ``errors`` says.

    "strict" and the handlers that are strict about such characters replace them by a question mark.
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
    """A text stream on top of another one that may be None, closed, full, or read by a program that has ended.

    Writing never fails: what nobody can read any more is dropped. ``failure`` is the error of a full disk.
    """

    def __init__(self, below: Any) -> None:
        self.below = below
        self.failure: OSError | None = None
        self._gone = below is None

    @property
    def encoding(self) -> str:  # type: ignore[override]
        """The encoding of the stream below."""
        return str(getattr(self.below, "encoding", None) or "utf-8")

    @property
    def errors(self) -> str:  # type: ignore[override]
        """What the stream below does with characters that its encoding lacks."""
        return str(getattr(self.below, "errors", None) or "strict")

    def write(self, text: str) -> int:
        """Write what the encoding can show."""
        with self._going_on():
            if not self._gone:
                try:
                    self.below.write(fitting(text, self.encoding, self.errors))
                except UnicodeEncodeError:  # a stream that does not say which encoding it has
                    self.below.write(fitting(text, "ascii"))
        return len(text)

    def flush(self) -> None:
        """Flush the stream below."""
        with self._going_on():
            if not self._gone and hasattr(self.below, "flush"):
                self.below.flush()

    def close(self) -> None:
        """Leave the stream below open: it belongs to somebody else."""
        self.flush()

    def writable(self) -> bool:
        """Return True."""
        return True

    def isatty(self) -> bool:
        """Return whether the stream below is a terminal."""
        with suppress(OSError, ValueError, AttributeError):
            return not self._gone and bool(self.below.isatty())
        return False

    def fileno(self) -> int:
        """Return the descriptor of the stream below."""
        if not hasattr(self.below, "fileno"):
            raise io.UnsupportedOperation("fileno")
        return int(self.below.fileno())

    def __getattr__(self, name: str) -> Any:
        if name == "below":  # of a copy that is not made yet
            raise AttributeError(name)
        return getattr(self.below, name)

    @contextmanager
    def _going_on(self) -> Iterator[None]:
        try:
            yield
        except BlockingIOError:  # a pipe that is full for now
            pass
        except (OSError, ValueError) as error:  # ValueError: it was closed
            if isinstance(error, OSError) and error.errno in FULL:
                self.failure = error
            else:
                self.drop()

    def drop(self) -> None:
        """Write nothing more; what is left in the buffer of a standard stream goes to the null device.

        Otherwise the interpreter would try to write it at its end, and fail.
        """
        self._gone = True
        if self.below is not None and self.below in (sys.__stdout__, sys.__stderr__):
            with suppress(OSError, ValueError):
                null = os.open(os.devnull, os.O_WRONLY)
                os.dup2(null, self.below.fileno())
                os.close(null)


class Plain(Stream):
    """A `Stream` that writes control characters out; below it is ``raw``, for codes that the program itself makes."""

    def __init__(self, below: Any) -> None:
        self.raw = below if isinstance(below, Stream) else Stream(below)
        super().__init__(self.raw)

    def write(self, text: str) -> int:
        """Write the text without control characters."""
        self.raw.write(printable(text))
        return len(text)


@contextmanager
def kept_streams() -> Iterator[tuple[Stream, Stream]]:
    """While the block runs, standard output and standard error are `Plain` streams; yields their ``raw`` ones."""
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
    """Open the null device in place of standard streams that are closed.

    The next files to be opened would take their numbers, and what a library or a child process prints would be written
    into them.
    """
    with suppress(OSError):
        while (descriptor := os.open(os.devnull, os.O_RDWR)) < 3:
            os.set_inheritable(descriptor, True)
        os.close(descriptor)


def raw(stream: Any) -> Any:
    """Return the stream that codes for a terminal can be written to."""
    return stream.raw if isinstance(stream, Plain) else stream


def lowest(stream: Any) -> Any:
    """Return the stream below all of ours."""
    while isinstance(stream, Stream):
        stream = stream.below
    return stream


def say(text: str = "") -> None:
    """Write a line, or several, to standard output."""
    write_line(sys.stdout, text)


def complain(text: str) -> None:
    """Write one line that begins with ``asg:`` to standard error."""
    write_line(sys.stderr, f"asg: {one_line(text)}")


def write_line(stream: Any, text: str) -> None:
    """Write text and a line end to a stream, and never fail."""
    stream = stream if isinstance(stream, Plain) else Plain(stream)
    stream.write(f"{text}\n")
    stream.flush()


def flat(text: str) -> str:
    """Return foreign text as one printable line, however long."""
    return printable(text).replace("\n", " ")


def escape(text: str) -> str:
    """Return foreign text as one printable line in which rich finds no markup."""
    from rich.markup import escape as without_markup

    return without_markup(flat(text))
