"""The page in a real browser, and the command that writes it."""

from __future__ import annotations

import html
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from activestructure_gym.evaluation.archive.store import Run
from activestructure_gym.evaluation.cli import main
from activestructure_gym.evaluation.replay import Recording, replay_page, write_replay
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
    assert page.count('class="recording"') == 2 and 'class="pair"' in page
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
            pictures.append((page.value(f"player.runs[0].scene.countAt({moment.frame})"), page.picture()[:, :700]))
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
    assert "neither a finished run nor a comparison" in capsys.readouterr().err
    assert main(["replay", one, "--out", "nowhere/replay.html"]) == 2


@needs_browser
@pytest.mark.parametrize("width", [390, 1280])
def test_the_reason_of_the_current_decision_is_shown(
    page: Page, recordings: list[Recording], tmp_path: Path, width: int
) -> None:
    write_replay(recordings[:1], tmp_path / "replay.html")
    page.ask("Emulation.setDeviceMetricsOverride", width=width, height=800, deviceScaleFactor=1, mobile=False)
    page.open((tmp_path / "replay.html").as_uri())
    page.until("window.player && player.drawn > 0")
    panel = "document.querySelector('.why')"
    for moment in recordings[0].moments[:2]:
        page.value(f"player.to({moment.frame}); 1")
        page.until("player.dirty === false")
        row = recordings[0].run.steps[moment.decision]["action"]
        assert f"row {row} scores" in page.value(f"{panel}.textContent")
    assert page.value("document.documentElement.scrollWidth") == width
    assert page.value(f"{panel}.open") is True
    box = f"{panel}.getBoundingClientRect()"
    assert page.value(f"{box}.left >= 0 && {box}.right <= {width} && {box}.height < 320")
    page.value("document.getElementById('show-why').click(), 1")
    page.until("player.dirty === false")
    assert page.value(f"{panel}.hidden") is True
    page.value("document.getElementById('show-why').click(), player.to(player.end), 1")
    page.until("player.dirty === false")
    assert page.value(f"{panel}.hidden") is True  # no decision follows the last keyframe
    assert page.errors == []
    page.ask("Emulation.clearDeviceMetricsOverride")
