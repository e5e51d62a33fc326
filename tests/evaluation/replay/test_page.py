"""The page in a real browser, and the command that writes it."""

from __future__ import annotations

import html
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from activestructure_gym.evaluation.archive.store import Run
from activestructure_gym.evaluation.cli import main
from activestructure_gym.evaluation.replay import Recording, reasons, replay_page, write_replay
from activestructure_gym.evaluation.replay.page import names_of
from tests.browser import BROWSER, Page, open_page


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    """One browser for all of them."""
    with open_page("about:blank", tmp_path_factory.mktemp("browser"), width=1200, height=600) as page:
        yield page


needs_browser = pytest.mark.skipif(BROWSER is None, reason="there is no Chromium here")


def test_the_page_needs_nothing_else_and_names_are_escaped(recordings: list[Recording]) -> None:
    page = html.unescape(replay_page(recordings))
    assert "default-src 'none'" in page and 'src="http' not in page and "@import" not in page
    assert page.count('class="recording"') == 2 and '<body class="pair">' in page
    assert "<title>box · seed 0: hole_area and random</title>" in page
    object.__setattr__(recordings[0].run, "scene", "<script>alert(1)</script>")
    try:
        assert "<script>alert" not in replay_page(recordings)
    finally:
        object.__setattr__(recordings[0].run, "scene", "box")


@pytest.mark.slow
@needs_browser
def test_it_plays_scrubs_and_turns_without_an_error(page: Page, recordings: list[Recording], tmp_path: Path) -> None:
    write_replay(recordings[:1], tmp_path / "replay.html")
    page.open((tmp_path / "replay.html").as_uri())
    page.until("window.player && player.drawn > 0")
    first = page.picture()
    assert first.std() > 10  # something is drawn
    page.value("player.to(player.end); 1")
    page.until("player.dirty === false")
    last = page.picture()
    assert (np.abs(first.astype(int) - last) > 20).mean() > 0.02
    assert page.value("player.runs[0].scene.drawn") == len(recordings[0].added)
    # All at once, and decision by decision into a kept picture, look the same.
    page.value("player.to(1); 1")
    page.until("player.dirty === false")
    for moment in recordings[0].moments[1:]:
        page.value(f"player.to({moment.frame}); 1")
        page.until("player.dirty === false")
    assert (np.abs(page.picture().astype(int) - last) > 20).mean() < 0.01
    page.value("player.runs[0].orbit.turn(200, 0); player.dirty = true; 1")
    page.until("player.dirty === false")
    assert (np.abs(page.picture().astype(int) - last) > 20).mean() > 0.02
    frame = page.value("player.to(1), player.play(), player.clock")
    page.until(f"player.clock > {frame} + 2")
    place = page.value("(({ x, y }) => [x + 9, y + 9])(document.getElementById('play').getBoundingClientRect())")
    page.click(*place)
    assert page.value("player.playing") is False
    # While it plays, who is gone may stay for a moment; when it rests nobody does.
    page.value("player.to(player.end), 1")
    page.until("player.dirty === false")
    whole = page.picture()
    page.value("""(() => {
        const run = player.runs[0], { added, removed } = run.arrays;
        for (let i = 0; i < added.length; i++) if (added[i] < player.end / 2) removed[i] = player.end - 2;
        run.scene.load(); player.usual = player.end; player.to(player.end);
    })()""")
    page.until("player.dirty === false")
    without = page.picture()
    page.value("player.to(1); player.play()")
    page.until("!player.playing && player.dirty === false")
    assert (np.abs(page.picture().astype(int) - without) > 20).mean() < 0.01
    assert (np.abs(whole.astype(int) - without) > 20).mean() > 0.01
    page.value("document.getElementById('eye').value = 'agent', player.dirty = true")
    page.until("player.dirty === false")
    assert page.errors == []


@pytest.mark.slow
@needs_browser
def test_a_long_episode_is_drawn_as_a_short_one(page: Page, recordings: list[Recording], tmp_path: Path) -> None:
    """Frames of more than 16 bits: who is there at a moment does not depend on how many frames were paid before."""
    one, pictures = recordings[0], []
    moments = [replace(moment, frame=2000 * moment.frame) for moment in one.moments]
    never_removed = np.iinfo(np.int32).max
    removed = np.where(one.removed == never_removed, never_removed, np.minimum(one.removed, 10**6) * 2000).astype(
        np.int32
    )
    removed[::50] = moments[-2].frame
    long = replace(one, moments=moments, added=2000 * one.added, removed=removed)
    short_removed = one.removed.copy()
    short_removed[::50] = one.moments[-2].frame
    for recording in (replace(one, removed=short_removed), long):
        assert (recording.moments[-1].frame > 65_535) == (recording is long)
        write_replay([recording], tmp_path / "replay.html")
        page.open((tmp_path / "replay.html").as_uri())
        page.until("window.player && player.drawn > 0")
        for moment in (recording.moments[1], recording.moments[-1]):
            page.value(f"player.to({moment.frame}); 1")
            page.until("player.dirty === false")
            pictures.append(
                (page.value(f"player.runs[0].scene.countAt({moment.frame})"), page.picture()[100:300, 20:700])
            )
    for (count, shown), (count_long, shown_long) in zip(pictures[:2], pictures[2:]):
        assert count == count_long > 0
        assert (np.abs(shown.astype(int) - shown_long) > 20).mean() < 0.01
    assert pictures[1][0] == len(one.added) - int((short_removed <= one.moments[-1].frame).sum())
    assert page.errors == []


@pytest.mark.slow
@needs_browser
def test_two_runs_share_a_clock_and_a_camera(page: Page, recordings: list[Recording], tmp_path: Path) -> None:
    write_replay(recordings, tmp_path / "replay.html")
    page.open((tmp_path / "replay.html").as_uri())
    page.until("window.player && player.drawn > 0")
    page.value("player.to(player.end); 1")
    page.until("player.dirty === false")
    assert page.value("player.runs.map((run) => run.scene.drawn)") == [len(one.added) for one in recordings]
    shown = page.picture()
    assert shown[100:300, 50:500].std() > 5 and shown[100:300, 650:1100].std() > 5
    assert page.errors == []


def test_the_command_writes_a_page_and_says_what_it_takes(
    finished: list[Run], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    one, other = (str(run.directory) for run in finished)
    assert main(["replay", one, "--out", "one.html"]) == 0
    assert "one.html" in capsys.readouterr().out and (tmp_path / "one.html").stat().st_size > 50_000
    assert main(["replay", str(finished[0].directory.parents[1])]) == 0  # a comparison of two runs
    assert (tmp_path / "replay.html").read_text().count('class="recording"') == 2
    assert main(["replay", one, other, one]) == 2
    assert "shows one run or two, got 3" in capsys.readouterr().err
    assert main(["replay", str(tmp_path)]) == 2
    assert "has no finished run: it has no .done file" in capsys.readouterr().err
    (tmp_path / "compare.json").touch()
    assert main(["replay", str(tmp_path)]) == 2
    assert "has no finished run: it is a comparison, none of whose runs has ended" in capsys.readouterr().err
    assert main(["replay", one, "--out", "nowhere/replay.html"]) == 2


@needs_browser
def test_the_reason_of_the_current_decision_is_shown(page: Page, recordings: list[Recording], tmp_path: Path) -> None:
    write_replay(recordings[:1], tmp_path / "replay.html")
    page.ask("Emulation.setDeviceMetricsOverride", width=390, height=800, deviceScaleFactor=1, mobile=False)
    page.open((tmp_path / "replay.html").as_uri())
    page.until("window.player && player.drawn > 0")
    panel = "document.querySelector('.why')"
    box = f"{panel}.getBoundingClientRect()"
    for moment, width in zip(recordings[0].moments, (390, 1280)):
        page.ask("Emulation.setDeviceMetricsOverride", width=width, height=800, deviceScaleFactor=1, mobile=False)
        page.value(f"player.to({moment.frame}); 1")
        page.until("player.dirty === false")
        reason = reasons.reason("hole_area", recordings[0].run.decisions[moment.decision])
        assert page.value(f"{panel}.querySelector('summary').textContent") == reason
        assert page.value("document.documentElement.scrollWidth") == width
        assert page.value(f"{panel}.open") is True
        assert page.value(f"{box}.left >= 0 && {box}.right <= {width} && {box}.height < 320")
    page.value("player.to(player.end), 1")
    page.until("player.dirty === false")
    assert page.value(f"{panel}.hidden") is True  # no decision follows the last keyframe
    assert page.errors == []
    page.ask("Emulation.clearDeviceMetricsOverride")


@pytest.fixture(scope="module")
def of_both(page: Page, recordings: list[Recording], tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    """The page of both runs on a phone, opened once; what changes it for good comes last."""
    place = tmp_path_factory.mktemp("pair") / "replay.html"
    write_replay(recordings, place)
    page.ask("Emulation.setDeviceMetricsOverride", width=390, height=844, deviceScaleFactor=1, mobile=False)
    page.open(place.as_uri())
    page.until("window.player && player.drawn > 0")
    yield page
    page.ask("Emulation.clearDeviceMetricsOverride")


@pytest.fixture
def pair(of_both: Page) -> Iterator[Page]:
    """The page of both runs at the middle of the episode."""
    of_both.value("player.to(20), 1")
    of_both.until("player.dirty === false")
    yield of_both
    assert of_both.errors == []
    of_both.ask("Emulation.setEmulatedMedia", features=[])


@needs_browser
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_each_run_and_layer_has_a_colour_of_its_own(pair: Page, scheme: str) -> None:
    pair.ask("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])
    shown = pair.value("""[
        ...Array.from(document.querySelectorAll('.stage h2'), (name) => getComputedStyle(name).color),
        ...Array.from(document.querySelectorAll('.layers i'), (mark) => {
            const { backgroundImage, backgroundColor } = getComputedStyle(mark);
            return backgroundImage === 'none' ? backgroundColor : backgroundImage; })]""")
    colours = [tuple(map(int, found)) for one in shown for found in re.findall(r"rgb\((\d+), (\d+), (\d+)\)", one)]
    assert len(colours) == 2 + 8  # candidates have two: of the lowest and of the highest score
    lab = cv2.cvtColor(np.array([colours], np.float32) / 255, cv2.COLOR_RGB2Lab)[0]
    apart = np.linalg.norm(lab[:, None] - lab[None], axis=2) + 1e3 * np.eye(len(lab))
    assert apart.min() > 25  # 2.3 is just noticeable


@needs_browser
def test_the_first_screen_of_a_phone_has_both_maps_and_the_button(pair: Page) -> None:
    boxes = pair.value("""Array.from(document.querySelectorAll('.stage, #play, #clock'), (one) => {
        const { left, right, top, bottom, height } = one.getBoundingClientRect();
        return [left, right, top, bottom, height]; })""")
    assert len(boxes) == 4 and pair.value("document.documentElement.scrollWidth") == 390
    for left, right, top, bottom, _ in boxes:
        assert left >= 0 and right <= 390 and top >= 0 and bottom <= 844
    (_, _, first, between, height), (_, _, second, end, other), (_, _, play, *_), (_, _, clock, *_) = boxes
    assert height == other > 250 and between <= second and end <= play < clock
    assert pair.picture()[int(first) + 60 : int(between) - 60].std() > 5  # the map is drawn


@needs_browser
def test_a_candidate_under_the_pointer_shows_what_it_sees_and_costs(pair: Page, recordings: list[Recording]) -> None:
    pair.value("document.getElementById('show-candidates').click(), 1")
    pair.until("player.dirty === false")
    row, x, y = pair.value("""(() => {
        const run = player.runs[0], box = run.canvas.getBoundingClientRect();
        for (let y = Math.ceil(box.top) + 40; y < box.bottom - 80; y += 4)
          for (let x = Math.ceil(box.left) + 20; x < box.right - 20; x += 4) {
            const row = player.under(run, { clientX: x, clientY: y });
            if (row >= 0) return [row, x, y];
          } })()""")
    pair.ask("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y)
    pair.until("!document.getElementById('tip').hidden")
    moment = [moment for moment in recordings[0].moments if moment.frame <= 20][-1]
    rank = 1 + int((moment.scores.astype(np.float32) > np.float32(moment.scores[row])).sum())
    *_, metres, frames = moment.candidates[row]
    lines = pair.value("Array.from(document.querySelectorAll('#tip p'), (one) => one.textContent)")
    assert lines[0].endswith("the map seen from there")
    assert lines[1].startswith("hole_area ") and lines[1].endswith(f", rank {rank} of {len(moment.candidates)}")
    assert lines[2] == f"costs {frames:.0f} frames, {metres:.2f} m"
    pixels = "document.querySelector('#tip canvas').getContext('2d').getImageData(0, 0, 320, 180).data"
    assert pair.value(f"new Set({pixels}).size") > 20  # the map is drawn
    pair.ask("Input.dispatchMouseEvent", type="mouseMoved", x=2, y=2)
    pair.until("document.getElementById('tip').hidden")
    pair.value("document.getElementById('show-candidates').click(), 1")


@needs_browser
def test_the_page_begins_with_the_map_path_and_choice_and_says_who_leads(
    pair: Page, recordings: list[Recording]
) -> None:
    ticked = pair.value("Array.from(document.querySelectorAll('.layers :checked'), (box) => box.id)")
    assert ticked == ["show-map", "show-path", "show-chosen", "show-images"]
    found = {
        run.policy: [point["observed"] for point in run.metrics["curve"] if point["frames"] <= 20][-1]
        for run in (one.run for one in recordings)
    }
    best, other = sorted(found, key=found.__getitem__, reverse=True)
    said = pair.value("document.getElementById('lead').textContent").replace("\N{NO-BREAK SPACE}", " ")
    shares = f"{found[best]:.1f} % of the surface observed, {other} {found[other]:.1f} %"
    assert said == f"{best} leads after 20 of 40 frames: {shares}."
    names = pair.value(
        "Array.from(document.querySelectorAll('.chart figcaption'), (one) => one.firstChild.textContent)"
    )
    assert names == ["observed surface", "completion ratio (C.R.)", "PSNR"]
    labels = pair.value("Array.from(document.querySelectorAll('.chart:first-child text'), (one) => one.textContent)")
    assert labels[:5] == ["0", "50", "100", "20", "40 frames"]
    ends = [f"{one.run.policy} {one.run.metrics['metrics']['observed']:.1f}" for one in recordings]
    assert labels[-2:] == ends
    begun = "Array.from(new Chart(MEASURES[0], player.runs, 2).svg.querySelectorAll('text'), (one) => one.textContent)"
    assert pair.value(begun)[3:5] == ["1", "2 frames"]  # no half frames
    legend = "document.getElementById('scores').textContent"
    assert pair.value(legend) == "other candidates, low to high hole_area"
    pair.value("player.runs[1].film.feature = 'pixel', player.open(player.runs), 1")
    assert pair.value(legend) == "other candidates, low to high hole_area or pixel"


def test_names_have_what_differs_between_the_runs(finished: list[Run]) -> None:
    greedy, chance = finished
    assert names_of([greedy]) == ("box · seed 0", ["hole_area"])
    assert names_of([greedy, chance]) == ("box · seed 0", ["hole_area", "random"])
    assert names_of([greedy, greedy]) == ("box · seed 0", ["hole_area", "hole_area"])
    again = replace(greedy, job=replace(greedy.job, seed=7))
    assert names_of([greedy, again]) == ("hole_area · box", ["seed 0", "seed 7"])
