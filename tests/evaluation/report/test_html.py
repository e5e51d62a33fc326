import base64
import json
import re
import zlib

import pytest
from jinja2 import UndefinedError
from markupsafe import Markup

from activestructure_gym.evaluation.report.html import html_table, render
from activestructure_gym.evaluation.report.tables.formats import latex
from activestructure_gym.evaluation.report.tables.layout import Cell, Heading, Table


def test_text_is_escaped_and_markup_is_not():
    assert render("costs.html.j2", table="a < b") == '<section id="costs"><h2>Costs</h2>a &lt; b</section>'
    assert "<b>c</b>" in render("costs.html.j2", table=Markup("<b>c</b>"))
    assert 'alt="say &#34;no&#34;"' in render("picture.html.j2", source="data:,", alt='say "no"', width=1, height=2)


def test_what_a_template_lacks_is_an_error():
    with pytest.raises(UndefinedError):
        render("costs.html.j2")


def test_line_breaks_of_a_template_leave_nothing_beside_tags_and_a_space_within_text():
    text = render("chart_grid.html.j2", rows=[("a < b", [Markup("<svg></svg>")])])
    assert "\n" not in text and "> " not in text and " <" not in text and "begin at the end of the first" in text


def table(**changes):
    rows = [[Cell("a"), Cell("1.0 [0.5, 1.5]", 1.0, rank=1)], [Cell("<b>"), Cell("3", 3.0, tone="alarm")]]
    return Table("t", "T", [Heading("policy", numeric=False), Heading("x")], rows, **changes)


def test_a_table_has_ranks_values_and_buttons_to_sort_it():
    text = html_table(table(), colours=["a"])
    assert '<td class="n r1" title="1st" data-value="1.0">1.0<small> [0.5, 1.5]</small></td>' in text
    assert '<td class="n alarm" data-value="3.0">3</td>' in text and "&lt;b&gt;" in text and "<b>3" not in text
    assert text.count("<button") == 3 and 'class="dot p0"' in text


def test_an_arrow_stays_with_its_heading():
    text = html_table(Table("t", "T", [Heading("m"), Heading("PSNR (dB) ↑")], [[Cell("a"), Cell("1")]]))
    assert "PSNR (dB)\u00a0↑" in text


def test_a_table_carries_its_latex_only_where_its_values_are_exact():
    packed = re.search(r'data-latex="([^"]+)"', html_table(table()))[1]
    assert json.loads(zlib.decompress(base64.b64decode(packed))) == [latex(table())]
    assert "data-latex" not in html_table(table(), exact=False)


def test_blocks_span_their_name():
    rows = [[Cell("a"), Cell("1")], [Cell("a"), Cell("2")], [Cell("b"), Cell("3")]]
    text = html_table(Table("t", "T", [Heading("m", numeric=False), Heading("x")], rows, blocks=[2]))
    assert text.count("<tbody>") == 2 and 'rowspan="2">a</th>' in text
    assert text.count(">a</th>") == 1
