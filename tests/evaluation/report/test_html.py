from activestructure_gym.evaluation.report.html import Html, element, html_table, joined
from activestructure_gym.evaluation.report.layout import Cell, Heading, Table


def test_text_is_escaped_and_markup_is_not():
    assert element("p", "a < b", Html("<b>c</b>"), None) == "<p>a &lt; b<b>c</b></p>"
    assert element("i", title='say "no"', class_="x", hidden=True, id_=None, data_value=0) == (
        '<i title="say &quot;no&quot;" class="x" hidden data-value="0"></i>'
    )
    assert element("br") == "<br>" and joined("&", Html("&")) == "&amp;&"


def table(**changes):
    rows = [[Cell("a"), Cell("1.0 [0.5, 1.5]", 1.0, rank=1)], [Cell("<b>"), Cell("3", 3.0, tone="alarm")]]
    return Table("t", "T", [Heading("policy", numeric=False), Heading("x")], rows, **changes)


def test_a_table_has_ranks_values_and_buttons_to_sort_it():
    text = html_table(table(), colours=["a"])
    assert '<td class="n r1" title="1st" data-value="1.0">1.0<small> [0.5, 1.5]</small></td>' in text
    assert '<td class="n alarm" data-value="3.0">3</td>' in text and "&lt;b&gt;" in text and "<b>3" not in text
    assert text.count("<button") == 2 and 'class="dot p0"' in text


def test_an_arrow_stays_with_its_heading():
    text = html_table(Table("t", "T", [Heading("m"), Heading("PSNR (dB) ↑")], [[Cell("a"), Cell("1")]]))
    assert "PSNR (dB)\u00a0↑" in text


def test_blocks_span_their_name_and_are_not_sorted():
    rows = [[Cell("a"), Cell("1")], [Cell("a"), Cell("2")], [Cell("b"), Cell("3")]]
    text = html_table(Table("t", "T", [Heading("m", numeric=False), Heading("x")], rows, blocks=[2]))
    assert text.count("<tbody>") == 2 and 'rowspan="2">a</th>' in text and "<button" not in text
    assert text.count(">a</th>") == 1
