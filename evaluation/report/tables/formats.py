"""Write tables as Markdown, CSV and LaTeX."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Sequence

from activestructure_gym.evaluation.report.tables.layout import Cell, Table

_RANK_MARKS = {1: "**{}** ¹", 2: "{} ²", 3: "{} ³"}
# Characters to escape in Markdown. An underscore within a word needs no escape.
_MARKDOWN = re.compile(r"[\\`*|<]|(?<![A-Za-z0-9])_|_(?![A-Za-z0-9])")
_SPAN = re.compile(r"((?<!`)`[^`\n<\[]+`(?!`))")  # a code span without tags and links
# The place before a formula in a cell. In some countries, spreadsheets also separate cells by semicolons.
_FORMULA = re.compile(r"(^|;)(?=[=@\t\r]|[+-](?![\d.]))")
_LATEX_RANKS = {1: r"\textbf{{{}}}", 2: r"\underline{{{}}}", 3: r"\textit{{{}}}"}
_LATEX = {
    "\\": r"\textbackslash{}", "&": r"\&", "%": r"\%", "$": r"\$", "#": r"\#", "_": r"\_", "{": r"\{", "}": r"\}",
    "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "↓": r"$\downarrow$", "↑": r"$\uparrow$", "±": r"$\pm$",
    "−": "$-$", "–": "--", "²": r"\textsuperscript{2}", "·": r"$\cdot$", "γ": r"$\gamma$", "<": r"\textless{}",
    ">": r"\textgreater{}", "|": r"\textbar{}",
}  # fmt: skip


def markdown(table: Table) -> str:
    """Return a table as Markdown; the first three ranks are marked as in **1.0** ¹, 1.1 ², 1.2 ³."""
    headings = [heading.text for heading in table.headings]
    if table.groups:
        spans = [text for text, span in table.groups for _ in range(span)]
        headings = [f"{group} {heading}".strip() for group, heading in zip(spans, headings)]
    lines = [
        "| " + " | ".join(escaped(heading) for heading in headings) + " |",
        "|" + "".join("---:|" if heading.numeric else "---|" for heading in table.headings),
    ]
    for index, row in enumerate(table.rows):
        texts = [_marked(escaped(table.shown(index, k)), cell) for k, cell in enumerate(row)]
        lines.append("| " + " | ".join(texts) + " |")
    return "\n".join(lines) + "\n"


def to_csv(table: Table) -> str:
    """Return a table as CSV, with numbers without interval in full precision, and without ranks."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    spans = [text for text, span in table.groups for _ in range(span)] or [""] * len(table.headings)
    writer.writerow(
        [spreadsheet_text(f"{group} {heading.text}".strip()) for group, heading in zip(spans, table.headings)]
    )
    for row in table.rows:
        writer.writerow([_plain(cell) for cell in row])
    return text.getvalue()


def latex(table: Table) -> str:
    """Return a table as LaTeX for the package booktabs; rank 1 is bold, rank 2 underlined, rank 3 italic."""
    columns = "".join("r" if heading.numeric else "l" for heading in table.headings)
    lines = [r"\begin{table}", r"\centering", rf"\caption{{{latex_text(table.title)}. {latex_text(table.caption)}}}"]
    lines += [rf"\label{{tab:{table.name}}}", rf"\begin{{tabular}}{{{columns}}}", r"\toprule"]
    if table.groups:
        groups = [
            latex_text(text) if span == 1 else rf"\multicolumn{{{span}}}{{c}}{{{latex_text(text)}}}"
            for text, span in table.groups
        ]
        lines.append(" & ".join(groups) + r" \\")
    lines += [" & ".join(latex_text(heading.text) for heading in table.headings) + r" \\", r"\midrule"]
    for index, row in enumerate(table.rows):
        if index and index in table.blocks:
            lines.append(r"\midrule")
        cells = []
        for column, cell in enumerate(row):
            text = latex_text(table.shown(index, column))
            cells.append(_LATEX_RANKS[cell.rank].format(text) if cell.rank else text)
        lines.append(" & ".join(cells) + r" \\")
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}", r"\end{table}", ""])


def latex_text(text: str) -> str:
    """Replace the special characters of LaTeX in ``text`` by commands."""
    return re.sub("|".join(map(re.escape, _LATEX)), lambda found: _LATEX[found.group()], text)


def documents(tables: Sequence[Table]) -> dict[str, str]:
    """Return the contents of all tables as Markdown, CSV and LaTeX files, by file name."""
    return {
        f"{table.name}.{ending}": form(table)
        for table in tables
        for ending, form in (("md", _titled), ("csv", to_csv), ("tex", latex))
    }


def _plain(cell: Cell) -> str:
    """Return the CSV text of a cell: a single number in full precision, other texts with "-" as the minus sign."""
    if cell.value is None or not cell.text.strip("+-−").replace(",", "").replace(".", "").isdigit():
        return spreadsheet_text(cell.text.replace("−", "-"))
    return repr(cell.value)


def _titled(table: Table) -> str:
    return "\n".join(
        part for part in (f"**{escaped(table.title)}.** {sentence(table.caption)}".rstrip(), "", markdown(table))
    )


def _marked(text: str, cell: Cell) -> str:
    return _RANK_MARKS[cell.rank].format(text) if cell.rank and text else text


def escaped(text: str) -> str:
    """Return a text as one line of Markdown, with table bars, tags, links and emphasis escaped."""
    return _escaped(" ".join(text.split()))


def _escaped(text: str) -> str:
    return _MARKDOWN.sub(r"\\\g<0>", text).replace("](", "]\\(")


def sentence(text: str) -> str:
    """Return a text as one line of Markdown in which code in backticks stays code; the rest is escaped."""
    return "".join(part if at % 2 else _escaped(part) for at, part in enumerate(_SPAN.split(" ".join(text.split()))))


def code(text: str) -> str:
    """Return a text as a Markdown code span in one line; the text may contain backticks."""
    text = " ".join(text.split())
    fence = "`" * (1 + max((len(run) for run in re.findall("`+", text)), default=0))
    return f"{fence} {text} {fence}" if "`" in text else f"{fence}{text}{fence}"


def spreadsheet_text(text: str) -> str:
    """Put an apostrophe before formulas in a text, so spreadsheets do not execute them (OWASP, "CSV Injection")."""
    return _FORMULA.sub(r"\1'", text)
