import csv
import io
import re

import pytest

from activestructure_gym.evaluation.report.tables.formats import (
    code,
    documents,
    escaped,
    latex,
    latex_text,
    markdown,
    sentence,
    spreadsheet_text,
    to_csv,
)
from activestructure_gym.evaluation.report.tables.layout import Cell, Heading, Table, number

TABLE = Table(
    "quality",
    "Title & more",
    [Heading("Method", numeric=False), Heading("Acc (cm) ↓"), Heading("C.R. (%) ↑")],
    [
        [Cell("pixel_only"), Cell("1.23", 1.2345, rank=1), Cell("80.0", 80.0, rank=2)],
        [Cell("a|b"), Cell("n/a"), Cell("−1.0 [−2.0, 0.5]", -1.0, rank=3)],
    ],
    "A caption",
    groups=[("", 1), ("room?seed=4", 2)],
    blocks=[1],
)


def test_markdown():
    header, rule, first, second = markdown(TABLE).splitlines()
    assert header == "| Method | room?seed=4 Acc (cm) ↓ | room?seed=4 C.R. (%) ↑ |"
    assert rule == "|---|---:|---:|"
    assert first == "| pixel_only | **1.23** ¹ | 80.0 ² |"
    assert second == "| a\\|b | n/a | −1.0 [−2.0, 0.5] ³ |"


def test_csv_has_full_numbers_and_plain_minus_signs():
    rows = list(csv.reader(io.StringIO(to_csv(TABLE))))
    assert rows[1] == ["pixel_only", "1.2345", "80.0"]
    assert rows[2] == ["a|b", "n/a", "-1.0 [-2.0, 0.5]"]
    assert to_csv(Table("t", "T", [Heading("a")], [[number(-3.14159, 2)]])) == "a\n-3.14159\n"


def test_latex():
    text = latex(TABLE)
    assert r"\textbf{1.23} & \underline{80.0} \\" in text and r"\textit{$-$1.0 [$-$2.0, 0.5]}" in text
    assert r"pixel\_only" in text and r"\multicolumn{2}{c}{room?seed=4}" in text and r"Title \& more" in text
    assert r"C.R. (\%) $\uparrow$" in text and r"\begin{tabular}{lrr}" in text
    plain = re.sub(r"\\[{}]", "", text)
    assert plain.count("{") == plain.count("}") and text.isascii()
    for row in re.findall(r"^(.*) \\\\$", text, re.M)[1:]:  # the first has a cell that spans two
        assert len(re.findall(r"(?<!\\)&", row)) == 2


def test_what_latex_would_take_for_a_command_is_written_out():
    assert latex_text("a_b{c}%$#~^\\") == (r"a\_b\{c\}\%\$\#\textasciitilde{}\textasciicircum{}\textbackslash{}")


def test_every_table_comes_in_three_forms():
    assert sorted(documents([TABLE])) == ["quality.csv", "quality.md", "quality.tex"]


@pytest.mark.parametrize(
    "text, expected",
    [
        ("pixel_only", "pixel_only"), ("box?seed=2", "box?seed=2"), ("0.1 [0.0, 0.2]", "0.1 [0.0, 0.2]"),
        ("a|b", "a\\|b"), ("<b onclick=x>", "\\<b onclick=x>"), ("*loud*", "\\*loud\\*"), ("_soft_", "\\_soft\\_"),
        ("`rm`", "\\`rm\\`"), ("[here](http://evil)", "[here]\\(http://evil)"), ("two\nlines", "two lines"),
        ("a\\|b", "a\\\\\\|b"),
    ],
)  # fmt: skip
def test_names_stay_names_in_markdown(text, expected):
    assert escaped(text) == expected
    cells = re.split(r"(?<!\\)(?:\\\\)*\|", markdown(Table("t", "T", [Heading("a")], [[Cell(text)]])).splitlines()[2])
    assert len(cells) == 3  # one cell between two bars


def test_code_holds_backticks():
    assert code("asg compare") == "`asg compare`" and code("a `b`` c") == "``` a `b`` c ```"


@pytest.mark.parametrize(
    "text, kept", [("=1+1", False), ("@SUM(A1)", False), ("+cmd", False), ("-cmd", False), ("\tx", False),
                   ("random", True), ("-1.5", True), ("+0.3 [-0.1, 0.7]", True)]
)  # fmt: skip
def test_no_name_is_a_formula(text, kept):
    assert spreadsheet_text(text) == (text if kept else f"'{text}")
    assert to_csv(Table("t", "T", [Heading("a")], [[Cell(text)]])).splitlines()[1].strip('"') == spreadsheet_text(text)


@pytest.mark.parametrize(
    "text, shown",
    [
        ("By `activegamer`; see a_b.", "By `activegamer`; see a_b."),
        ("left out: <img src=x onerror=y>", "left out: \\<img src=x onerror=y>"),
        ("a `<b>` c", "a \\`\\<b>\\` c"),  # code of others with a tag in it is none
        ("``a`<i>` `b`", "\\`\\`a\\`\\<i>` `b\\`"),
        ("[x](javascript:y) `[x](z)`", "[x]\\(javascript:y) \\`[x]\\(z)\\`"),
        ("two\nlines # *", "two lines # \\*"),
    ],
)
def test_a_sentence_keeps_code_and_nothing_else(text, shown):
    assert sentence(text) == shown


def test_a_formula_behind_a_semicolon_is_none():
    assert spreadsheet_text("a;=1+1") == "a;'=1+1" and spreadsheet_text("a;b;-1") == "a;b;-1"
