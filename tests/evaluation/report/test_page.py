"""The page as text, and in a real browser."""

import re

import pytest

from activestructure_gym.evaluation.report.page import html_page
from activestructure_gym.evaluation.report.results import Results, Source
from tests.evaluation.report import chromium

HOSTILE = '<img src=x onerror="fetch(1)">'


@pytest.fixture(scope="session")
def browser():
    """One browser for all tests of this file."""
    if chromium.find() is None:
        pytest.skip("no Chromium here (apt-get install chromium)")
    try:
        browser = chromium.Browser()
    except (OSError, TimeoutError) as error:
        pytest.skip(f"Chromium does not start here: {error}")
    yield browser
    browser.close()


@pytest.fixture(scope="module")
def results(make_module_run, tmp_path_factory):
    """2 policies x 2 scenes x 2 seeds, one of them with a name that is markup, and a run that failed."""
    runs = [
        make_module_run(scene, policy, seed, planes=(scene, policy, seed) == ("room", "a", 0),
                        psnr=20.0 + seed + (policy == "a"))
        for scene in ("room", "box?seed=2") for policy in ("a", HOSTILE) for seed in range(2)
    ]  # fmt: skip
    source = Source(tmp_path_factory.mktemp("c"), "asg compare --scenes room", 2, {"room · c": "RuntimeError: <no>"})
    return Results(runs, [source], "a")


@pytest.fixture(scope="module")
def path(results, tmp_path_factory):
    """Its page."""
    path = tmp_path_factory.mktemp("page") / "report.html"
    path.write_text(html_page(results), encoding="utf-8")
    return path


def test_nothing_outside_of_the_page_is_named(path):
    text = path.read_text(encoding="utf-8")
    places = re.findall(r'(?:src|href|srcset|action|poster)="([^"]*)"', text)
    assert places and all(place.startswith(("data:", "#")) for place in places)
    assert not re.search(r"url\(|@import|https?:(?!//www\.w3\.org/2000/svg)", text)
    ids = re.findall(r' id="([^"]+)"', text)
    assert len(ids) == len(set(ids)) and {place[1:] for place in places if place[0] == "#"} <= set(ids)


def test_what_is_missing_and_what_collided_is_named(path, make_run):
    text = path.read_text(encoding="utf-8")
    assert "1 run missing" in text and "RuntimeError: &lt;no&gt;" in text and "Collisions." not in text
    text = html_page(Results([make_run(collisions=2)], []))
    assert "Collisions." in text and "2 steps" in text and 'class="n alarm" data-value="2">2<' in text
    assert "run missing" not in text and 'href="#against"' not in text  # nobody to compare with


def test_no_error_no_request_and_no_foreign_markup(path, browser):
    browser.open(path)
    assert browser.requests() == [path.resolve().as_uri()]
    assert browser.complaints() == []
    assert browser.ask("document.images.length") > 20
    assert browser.ask("[...document.images].every((image) => image.complete && image.naturalWidth > 0 && image.alt)")
    assert HOSTILE in browser.ask("document.body.textContent")
    # The policy of the page would stop a request that something tries all the same.
    assert browser.ask("fetch('https://example.org').then(() => 'sent', () => 'stopped')") == "stopped"


def test_tables_sort_curves_hide_and_dark_is_dark(path, browser):
    browser.prefer("light")
    browser.open(path)
    column = "[...document.querySelectorAll('#table-costs tbody tr')].map((row) => row.cells[0].textContent)"
    assert browser.ask(column) == ["a", HOSTILE]
    click = "document.querySelector('#table-costs thead button').click();"
    assert browser.ask(f"{click}{column}") == [HOSTILE, "a"]  # "<" before "a"
    assert browser.ask(f"{click}{column}") == ["a", HOSTILE]
    assert browser.ask("document.querySelector('#table-costs th').getAttribute('aria-sort')") == "descending"
    shown = "[...document.querySelectorAll('.series.p0')].filter((s) => getComputedStyle(s).display != 'none').length"
    before = browser.ask(shown)
    assert before >= 12 and browser.ask(f"document.querySelector('.legend').click();{shown}") == 0
    paper = "getComputedStyle(document.body).backgroundColor"
    assert browser.ask(paper) == "rgb(255, 255, 255)"
    dark = browser.ask(f"document.getElementById('theme').click();{paper}")
    assert max(int(part) for part in re.findall(r"\d+", dark)) < 50
    browser.ask("localStorage.clear()")
    browser.prefer("dark")
    browser.open(path)
    assert browser.ask(paper) == dark
    browser.prefer("light")


def test_a_policy_is_hidden_alone_where_another_has_its_colour(make_run, browser, tmp_path):
    page = tmp_path / "many.html"
    page.write_text(html_page(Results([make_run(policy=name) for name in "abcdefghij"], [])))
    browser.open(page)
    hidden = "new Set([...document.querySelectorAll('.series.off')].map((series) => series.dataset.name))"
    assert browser.ask(f"document.querySelector('.legend').click();[...{hidden}]") == ["a"]  # "i" has its colour
    assert browser.ask("document.querySelectorAll('svg.panels .panel').length") == 20


def test_it_fits_a_telephone(path, browser):
    browser.size(390, 800)
    try:
        browser.open(path)
        browser.ask("document.querySelectorAll('details').forEach((one) => { one.open = true; })")
        assert browser.ask("document.documentElement.scrollWidth") <= 390
    finally:
        browser.size(1280, 900)


def test_a_chart_can_be_read_off(path, browser):
    browser.open(path)
    browser.ask("document.querySelector('svg.chart[data-frame]').scrollIntoView()")
    said = browser.ask(
        """(() => { const chart = document.querySelector('svg.chart[data-frame]'), box = chart.getBoundingClientRect();
        const place = { clientX: box.left + box.width - 15, clientY: box.top + 9 };
        chart.dispatchEvent(new PointerEvent('pointermove', place));
        return document.querySelector('.reading').textContent; })()"""
    )
    # Near the last point of its C.R. curve, which is (100, 80).
    frames, ratio = re.match(r"frames: (\d\d)([\d.]+)  a", said).groups()
    assert int(frames) > 95 and float(ratio) == pytest.approx(60 + 20 * (int(frames) - 67) / 33, abs=0.7)
