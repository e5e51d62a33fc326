import re
from xml.etree import ElementTree

import numpy as np

from activestructure_gym.evaluation.report.charts.history_chart import history_chart


def titles(svg):
    return [group.find("text[@class='label']").text for group in svg.findall("g")]


def places(path):  # of every unbroken piece [P, 2]
    found = []
    for piece in path.split("M")[1:]:
        numbers = np.array([float(n) for n in re.findall(r"-?[\d.]+", piece)]).reshape(-1, 2)
        found.append(np.cumsum(numbers, axis=0))
    return found


def test_panels_stand_over_the_frames_and_values_hold_for_their_decision(steps):
    svg = ElementTree.fromstring(history_chart(steps))
    assert titles(svg) == [
        "mean deficit",
        "mean quality",
        "deficient area [m²]",
        "gain terms of the chosen view",
        "factors",
    ]
    width = float(svg.get("viewBox").split()[2])
    gain = svg.findall("g")[3].findall("path[@class='curve p5']")[0]  # pixel: 0.5, 0.25, ...
    (found,) = places(gain.get("d"))
    assert len(found) == 12 and found[-1, 0] == width - 10  # two ends of six decisions, up to the last frame
    np.testing.assert_allclose(found[0::2, 1], found[1::2, 1], atol=0.11)
    heights = found[0::2, 1].max() - found[0::2, 1]
    np.testing.assert_allclose(heights / heights[0], (1 / np.arange(1, 7) - 1 / 6) / (5 / 6), atol=0.01)


def test_a_decision_without_a_number_is_a_gap_and_a_run_without_any_has_no_chart(steps):
    steps[2]["trace"] = {"travel": 0.4}
    gain = ElementTree.fromstring(history_chart(steps)).findall("g")[3]
    assert [len(piece) for piece in places(gain.find("path[@class='curve p5']").get("d"))] == [4, 6]
    bare = [{"frames": step["frames"]} for step in steps]
    assert history_chart(bare) is None and history_chart([]) is None


def test_phases_are_bands_behind_the_curves_and_their_names_are_text(steps):
    for step, phase in zip(steps, ("a",) * 2 + ("<b>",) * 4):
        step["trace"] |= {"phase": phase, "<i>": 0.1}
    text = history_chart(steps)
    svg = ElementTree.fromstring(text)
    for group in svg.findall("g"):
        kinds = [part.get("class") for part in group.findall("path")]
        assert kinds[:2] == ["f0", "f1"] and "f0" not in kinds[2:]
    assert "<i>" not in text and "&lt;i&gt;" in text
