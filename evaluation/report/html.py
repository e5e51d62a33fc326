"""Writing HTML and SVG without a template engine: elements are functions, and text is escaped unless it is markup."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

from activestructure_gym.evaluation.report.layout import Cell, Table

_VOID = ("img", "br", "meta", "hr", "input", "link")


class Html(str):
    """Text that is markup already."""

    __slots__ = ()


def element(name: str, /, *children: str | None, **attributes: str | int | float | bool | None) -> Html:
    """``<name attributes>children</name>``; children that are not `Html` are escaped, None is left out.

    Of attribute names a trailing underscore is dropped and the others become hyphens; True stands alone, and an
    attribute that is None, False or empty is left out.
    """
    written = [name]
    for key, value in attributes.items():
        if value is None or value is False or value == "":
            continue
        key = key.rstrip("_").replace("_", "-")
        written.append(key if value is True else f'{key}="{escape(str(value), quote=True)}"')
    opening = f"<{' '.join(written)}>"
    return Html(opening) if name in _VOID else Html(f"{opening}{joined(*children)}</{name}>")


def joined(*children: str | None) -> Html:
    """Children one after the other."""
    return Html("".join(child if isinstance(child, Html) else escape(child) for child in children if child is not None))


def folded(summary: str, *children: str | None, open_: bool = False, class_: str | None = None) -> Html:
    """Content behind a line that opens it."""
    return element("details", element("summary", summary), *children, open=open_, class_=class_)


def html_table(table: Table, *, colours: Sequence[str] = ()) -> Html:
    """A table with its caption; policies named in ``colours`` carry their colour. Sortable where rows stand alone."""
    head = []
    if table.groups:
        head.append(
            element("tr", *(element("th", text, colspan=span, scope="colgroup") for text, span in table.groups))
        )
    cells = []
    for k, heading in enumerate(table.headings):
        content: str = heading.text.replace(" ↓", "\u00a0↓").replace(" ↑", "\u00a0↑")  # no arrow begins a line
        if table.sortable:
            content = element("button", content, type="button", data_column=k)
        cells.append(element("th", content, scope="col", class_="n" if heading.numeric else None, title=heading.note))
    head.append(element("tr", *cells))
    blocks: list[list[Html]] = [[]]
    for index, row in enumerate(table.rows):
        if index in table.blocks:
            blocks.append([])
        blocks[-1].append(_row(table, index, row, colours))
    bodies = [element("tbody", *block) for block in blocks]
    whole = element("table", element("thead", *head), *bodies, class_="sortable" if table.sortable else None)
    # The script shows the hint while there are columns to the right.
    hint = element("span", "more columns: scroll sideways →", class_="hint", aria_hidden="true")
    caption = element(
        "figcaption", element("b", f"{table.title}."), f" {table.caption}." if table.caption else "", hint
    )
    return element(
        "figure", caption, element("div", whole, class_="wide", tabindex="0", role="region", aria_label=table.title),
        class_="table", id_=f"table-{table.name}",
    )  # fmt: skip


def _row(table: Table, index: int, row: Sequence[Cell], colours: Sequence[str]) -> Html:
    cells = []
    for column, cell in enumerate(row):
        heading = table.headings[column]
        kind = " ".join(
            part for part in ("n" if heading.numeric else "", f"r{cell.rank}" if cell.rank else "", cell.tone) if part
        )
        rows_below = None
        if column == 0 and table.blocks:
            if table.shown(index, 0) == "":
                continue
            ends = [end for end in table.blocks if end > index]
            rows_below = (ends[0] if ends else len(table.rows)) - index
            same = [i for i in range(index, index + rows_below) if table.rows[i][0].text == cell.text]
            rows_below = len(same)
        text: str = cell.text
        for spread in (" [", " ± "):
            if heading.numeric and spread in text:
                value, _, rest = text.partition(spread)
                text = joined(value, element("small", f"{spread}{rest}"))
        name = cell.note or cell.text
        if not heading.numeric and name in colours:
            text = joined(element("i", class_=f"dot p{colours.index(name) % 8}", aria_hidden="true"), cell.text)
        says = {1: "1st", 2: "2nd", 3: "3rd"}.get(cell.rank, cell.note if cell.note != cell.text else None)
        cells.append(
            element(
                "th" if column == 0 else "td",
                text,
                class_=kind,
                title=says,
                scope="row" if column == 0 else None,
                rowspan=rows_below if rows_below and rows_below > 1 else None,
                data_value=repr(cell.value) if cell.value is not None else None,
            )  # fmt: skip
        )
    return element("tr", *cells)
