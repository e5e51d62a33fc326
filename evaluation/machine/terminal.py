"""Fit text to a terminal: break lines between words or parts of names, but not inside a number."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from rich.cells import cell_len, set_cell_size

GAP = 2  # blanks between two columns of a table
_BREAKS, _WITHIN = " /?&;:,", "_-"  # a line may end after a character of `_BREAKS`, and if necessary of `_WITHIN`
_MIN_COLUMNS = 8  # characters; the last entry of a row is left out if less room remains for it


def breaks(text: str, width: int) -> list[int]:
    """Return the indices in ``text`` at which lines of at most ``width`` terminal columns begin; the first is 0.

    A number is broken only if it is wider than a line.
    """
    starts, start = [0], 0
    while cell_len(text[start:].rstrip()) > width:
        end = start + 1
        while end < len(text) and cell_len(text[start : end + 1].rstrip()) <= width:
            end += 1
        places = range(end, start, -1)
        start = (
            next((at for at in places if _may_break(text, at)), 0)
            or next((at for at in places if _may_break(text, at, _WITHIN)), 0)
            or next((at for at in places if not _in_number(text, at)), end)
        )
        starts.append(start)
    return starts


def folded(text: str, width: int) -> list[str]:
    """Return ``text`` as a list of lines of at most ``width`` terminal columns."""
    starts = breaks(text, width)
    return [text[start:end].strip() for start, end in zip(starts, [*starts[1:], len(text)])]


def shortened(text: str, width: int, ellipsis: str = "…") -> str:
    """Return ``text``, cut and ended by ``ellipsis`` if it is wider than ``width`` terminal columns.

    The cut is never inside a number. The result is empty if ``width`` is less than the ellipsis.
    """
    if cell_len(text) <= width:
        return text
    if width < len(ellipsis):
        return ""
    end = len(set_cell_size(text, width - len(ellipsis)).rstrip())
    while end and _in_number(text, end):
        end -= 1
    return text[:end].rstrip(" ,;:.&?=") + ellipsis


def longest_piece(text: str) -> int:
    """Return the width, in terminal columns, of the widest part of ``text`` that cannot be broken into lines."""
    ends = [at for at in range(1, len(text)) if _may_break(text, at, _BREAKS + _WITHIN)]
    return max((cell_len(text[a:b].strip()) for a, b in zip([0, *ends], [*ends, len(text)])), default=0)


def aligned(
    rows: Sequence[Sequence[str]], width: int | None, most: Sequence[int] = (), ellipsis: str = "…"
) -> Iterator[str]:
    """Yield each row as a line of text in which the entries of all rows are aligned in columns.

    ``width`` is the width of the terminal in characters, None for no limit. The last entry of a row is shortened to
    fit. If fewer than `_MIN_COLUMNS` characters remain for it, it is left out and the other entries are folded.
    ``most`` limits the width of each column; a wider entry moves the following entries to the right. ``ellipsis`` marks
    shortened entries.
    """
    wide = [max(map(cell_len, column)) for column in list(zip(*rows))[:-1]]
    wide = [min(size, *most[k : k + 1]) if k < len(most) else size for k, size in enumerate(wide)]
    for row in rows:
        head = "".join(set_cell_size(entry, max(size, cell_len(entry))) + " " * GAP for entry, size in zip(row, wide))
        line = (head + row[-1]).rstrip()
        if width is None or cell_len(line) <= width:
            yield line
        elif width - cell_len(head) >= _MIN_COLUMNS:
            yield head + shortened(row[-1], width - cell_len(head), ellipsis)
        else:
            yield from _with_indent(head.rstrip(), width)


def paragraphs(text: str) -> Iterator[str]:
    """Yield the paragraphs and list items of a docstring, each joined to one line; empty lines stay.

    Headings of sections, their underlines, names of parameters and indented lines are lines of their own.
    """
    lines: list[str] = []
    for line in [*text.splitlines(), ""]:
        starts = not line.strip() or line.lstrip().startswith("- ") or line.startswith("    ") or _is_underline(line)
        if lines and (starts or lines[-1].startswith("    ") or _is_underline(lines[-1])):
            yield " ".join([lines[0].rstrip(), *(more.strip() for more in lines[1:])])
            lines = []
        if line.strip():
            lines.append(line)
        else:
            yield ""


def _is_underline(line: str) -> bool:
    return len(line) > 2 and set(line.strip()) == {"-"}


def _with_indent(line: str, width: int) -> Iterator[str]:
    """Yield ``line`` folded to ``width`` terminal columns; the lines after the first are indented by `GAP` blanks."""
    first, *rest = folded(line, width)
    yield first
    for more in folded(" ".join(rest), width - GAP) if rest else ():
        yield " " * GAP + more


def _may_break(text: str, at: int, behind: str = _BREAKS) -> bool:
    """Return whether a line may end before index ``at``: after a character of ``behind`` that is not in a number."""
    if not 0 < at < len(text) or text[at - 1] not in behind or text[at] in behind:
        return False
    digits = text[at - 2 : at - 1].isdigit() and at > 1, text[at].isdigit()
    return not (digits[1] and text[at - 1] == "-") and not (all(digits) and text[at - 1] in ",:/")


def _in_number(text: str, at: int) -> bool:
    """Return whether the characters at ``at`` - 1 and ``at`` belong to one number."""
    around = text[max(at - 2, 0) : at + 2]
    before, after = text[at - 1 : at], text[at : at + 1]
    digits = before.isdigit(), after.isdigit()
    return all(digits) or (any(digits) and (before in ".," or after in ".,") and sum(map(str.isdigit, around)) > 1)
