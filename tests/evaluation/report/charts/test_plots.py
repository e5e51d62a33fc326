import re
from xml.etree import ElementTree

import numpy as np
import pytest

from activestructure_gym.evaluation.report.charts.plots import (
    Bar,
    Line,
    interval_chart,
    line_chart,
    panel_chart,
    shortened,
    standalone,
    tick_text,
    ticks,
)


@pytest.mark.parametrize(
    "low, high, expected",
    [(0, 100, [0, 20, 40, 60, 80, 100]), (0.0, 0.3, [0, 0.1, 0.2, 0.3]), (-3.0, 7.0, [-4, -2, 0, 2, 4, 6, 8])],
)
def test_ticks_are_round_and_span_the_range(low, high, expected):
    np.testing.assert_allclose(ticks(low, high), expected, atol=1e-12)


@pytest.mark.parametrize("low", [14.1, -14.1, 1e-9, 3e12])
def test_ticks_of_values_that_differ_by_rounding_alone_are_those_of_one_value(low):
    found = ticks(low, np.nextafter(low, np.inf))
    np.testing.assert_allclose(found, ticks(low, low))
    assert len({tick_text(tick, found) for tick in found}) == len(found)


def test_ticks_of_one_value():
    found = ticks(5.0, 5.0)
    assert min(found) < 5.0 < max(found)


def test_tick_text_has_the_digits_its_step_needs():
    assert [tick_text(t, [0.0, 0.25, 0.5]) for t in (0.0, 0.25)] == ["0.0", "0.2"]
    assert tick_text(-2.0, [-2.0, 0.0]) == "−2" and tick_text(2.0, [0.0, 2.0], signed=True) == "+2"
    assert tick_text(-0.0, [-0.1, -0.0]) == "0.0"


def line(name="a", index=0, band=True):
    x = np.linspace(1.0, 100.0, 5)
    return Line(name, index, x, x / 2, *((x / 2 - 1, x / 2 + 1) if band else (None, None)))


def points_of(path: str) -> np.ndarray:  # [P, 2]
    """The places of a path that is a place and steps from there."""
    numbers = re.fullmatch(r"M([-\d. ]+)l([-\d. ]+)Z?", path).groups()
    first, steps = (np.array([float(n) for n in re.findall(r"-?[\d.]+", text)]).reshape(-1, 2) for text in numbers)
    return first + np.concatenate([[[0.0, 0.0]], np.cumsum(steps, axis=0)])


def test_steps_of_a_path_do_not_add_up_their_rounding():
    x = np.linspace(0.0, 7.0, 62)
    wave = Line("a", 0, x, 50.0 + 3.0 * np.sin(x))
    svg = ElementTree.fromstring(line_chart([wave], title="t", x_label="x", y_label="y"))
    left, top, right, bottom = (float(n) for n in svg.get("data-frame").split())
    low, high = (float(n) for n in svg.get("data-y").split())
    points = points_of(svg.find("g").find("path[@class='curve']").get("d"))
    wanted = bottom - (wave.y - low) / (high - low) * (bottom - top)
    assert np.abs(points[:, 1] - wanted).max() < 0.051 and np.abs(np.diff(points[:, 0])).max() < 7


def test_of_more_lines_than_colours_the_last_are_grey_and_lie_below():
    wave = np.array([1.0, 2.0])
    lines = [Line(f"policy {k}", k, wave, wave, wave - 1, wave + 1) for k in range(10)]
    svg = ElementTree.fromstring(line_chart(lines, title="t", x_label="x", y_label="y"))
    kinds = [group.get("class").split()[1:] for group in svg.findall("g")]
    assert kinds == [["s8", "rest"], ["s9", "rest"], *([f"s{k}", f"p{k}"] for k in range(8))]
    assert sum(group.find("path[@class='band']") is not None for group in svg.findall("g")) == 8
    whole = standalone(
        [[line_chart(lines, title="t", x_label="x", y_label="y")]], [one.name for one in lines], title=""
    )
    assert "2 others" in whole and ">policy 7<" in whole and ">policy 8<" not in whole


def test_a_curve_lies_where_its_values_are():
    chart = line_chart([line()], title="t", x_label="frames", y_label="C.R.")
    svg = ElementTree.fromstring(chart)
    left, top, right, bottom = (float(n) for n in svg.get("data-frame").split())
    (y_low, y_high) = (float(n) for n in svg.get("data-y").split())
    path = svg.find("g").find("path[@class='curve']").get("d")
    points = points_of(path)
    np.testing.assert_allclose((points[:, 0] - left) / (right - left) * 100.0, line().x, atol=0.02)
    np.testing.assert_allclose(y_low + (bottom - points[:, 1]) / (bottom - top) * (y_high - y_low), line().y, atol=0.02)
    assert svg.find("g").find("path[@class='band']") is not None
    assert svg.get("role") == "img" and svg.find("title").text == "t"


@pytest.mark.parametrize(("low", "high"), [(0.0, 80.0), (0.936, 0.954), (10_000.0, 50_000.0)])
def test_numbers_have_room_beside_the_label(low, high):
    curve = Line("a", 0, np.array([1.0, 2.0]), np.array([low, high]))
    svg = ElementTree.fromstring(line_chart([curve], title="t", x_label="x", y_label="y"))
    numbers = [text for text in svg.findall("text") if text.get("text-anchor") == "end"]
    starts = [float(text.get("x")) - 7.5 * len(text.text) for text in numbers]  # 13 px digits are that wide
    assert numbers and min(starts) >= 15.0  # where the letters of the label end
    assert float(svg.get("data-frame").split()[0]) > max(float(text.get("x")) for text in numbers)


def test_the_axis_reaches_what_it_is_to_hold():
    curve = Line("a", 0, np.array([1.0, 2.0]), np.array([0.93, 0.95]))
    chart = line_chart([curve], title="t", x_label="x", y_label="y", y_includes=(0.0, 1.0))
    assert ElementTree.fromstring(chart).get("data-y") == "0 1"


@pytest.mark.parametrize(("first", "begin"), [(1.0, 0.0), (19.0, 0.0), (80.0, 80.0), (83.0, 80.0)])
def test_an_axis_does_not_begin_far_before_its_curves(first, begin):
    curve = Line("a", 0, np.array([first, 100.0]), np.array([1.0, 2.0]))
    svg = ElementTree.fromstring(line_chart([curve], title="t", x_label="x", y_label="y"))
    assert [float(end) for end in svg.get("data-x").split()] == pytest.approx([begin, 100.0], abs=5.0)
    left, _, right, _ = (float(n) for n in svg.get("data-frame").split())
    x = float(svg.find("g").find("path[@class='curve']").get("d")[1:].split()[0])
    assert left <= x <= left + 0.2 * (right - left) + 1.0
    ElementTree.fromstring(line_chart([Line("a", 0, np.array([7.0]), np.ones(1))], title="", x_label="", y_label=""))


def test_every_policy_has_a_panel_with_its_own_curve_before_all_others():
    lines = [line(f"policy {k}", k, band=k != 1) for k in range(12)]
    svg = ElementTree.fromstring(panel_chart(lines, title="t", x_label="frames", y_label="C.R.", columns=5))
    panels = svg.findall("g")
    assert [panel.find("text[@class='label']").text for panel in panels] == [one.name for one in lines]
    others = svg.find("defs").find("path[@class='others']")
    assert others.get("d").count("M") == 12
    assert all(panel.find("use").get("href") == "#" + others.get("id") for panel in panels)
    assert [panel.find("path[@class='band']") is not None for panel in panels].count(False) == 1
    places = [tuple(map(float, re.findall(r"[\d.]+", panel.get("transform")))) for panel in panels]
    assert len({x for x, _ in places}) == 5 and len({y for _, y in places}) == 3
    curve = panels[0].find("path[@class='curve']").get("d")
    points = points_of(curve)
    np.testing.assert_allclose(points[:, 0] / points[-1, 0] * 100.0, lines[0].x, atol=0.1)
    np.testing.assert_allclose((1 - points[:, 1] / 104.0) * 60.0, lines[0].y, atol=0.1)  # the axis ends at 60
    ElementTree.fromstring(panel_chart([], title="", x_label="x", y_label="y"))


def test_a_file_of_charts_has_room_for_charts_and_names():
    says = {"title": "t", "x_label": "x", "y_label": "y"}
    charts = [line_chart([line()], **says), panel_chart([line()] * 9, **says)]
    few, many = (standalone([[chart] for chart in charts], names, title="") for names in ((), ["a long name"] * 36))
    heights = [float(chart.split('viewBox="')[1].split('"')[0].split()[3]) for chart in charts]
    assert float(ElementTree.fromstring(few).get("height")) == 40 + sum(heights) + 8
    size = ElementTree.fromstring(many)
    assert float(size.get("width")) == float(ElementTree.fromstring(few).get("width"))  # names go on in the next line
    assert float(size.get("height")) > 40 + sum(heights) + 60


def test_names_are_escaped_and_no_curve_is_no_error():
    chart = line_chart([line("<b>&", band=False)], title='"<', x_label="x", y_label="y")
    assert ElementTree.fromstring(chart).find("g").get("data-name") == "<b>&"
    assert "band" not in chart
    ElementTree.fromstring(line_chart([], title="", x_label="x", y_label="y"))


def test_intervals_stand_around_their_zero():
    bars = [Bar("a", 0, 2.0, 1.0, 3.0), Bar("b", 1, -1.0, None, None)]
    svg = ElementTree.fromstring(interval_chart(bars, title="t", x_label="l"))
    zero = float(re.match(r"M([\d.]+)", svg.find("path[@class='zero']").get("d")).group(1))
    first, second = svg.findall("g")
    low, high = (float(n) for n in re.findall(r"[ML]([\d.]+)", first.find("path[@class='interval']").get("d")))
    assert zero < low < high and second.find("path[@class='interval']") is None
    place = float(re.search(r"\(([\d.]+)", second.find("path[@class='mark']").get("transform")).group(1))
    assert place < zero
    assert "95 % interval +1 to +3" in first.find("title").text


def test_a_file_of_its_own_has_its_colours_and_a_legend():
    charts = [[line_chart([line("a"), line("b", 1)], title="t", x_label="x", y_label="y")] * 2] * 2
    text = standalone(charts, ["a", "b<"], title="whole")
    svg = ElementTree.fromstring(text)
    name = "{http://www.w3.org/2000/svg}"
    assert len(svg.findall(f"{name}svg")) == 4 + 2 and "prefers-color-scheme" in svg.find(f"{name}style").text
    assert "http" not in text.replace("http://www.w3.org/2000/svg", "")


def test_long_names_are_cut_in_the_middle():
    assert shortened("activestructure-a", 11) == "activ…ure-a" and shortened("short", 11) == "short"
