import io
import time

import pytest
from rich.console import Console

from activestructure_gym.evaluation.archive.jobs import Job
from activestructure_gym.evaluation.cli import output
from activestructure_gym.evaluation.running import live_progress as module
from activestructure_gym.evaluation.running.engines import Outcome
from activestructure_gym.evaluation.running.episode import Progress
from activestructure_gym.evaluation.running.live_progress import LiveProgress

JOBS = [Job("room", "random", 0), Job("room", "my[policy]", 0)]


@pytest.fixture
def clock(monkeypatch):
    class Clock:
        now = 100.0

        def monotonic(self):
            return self.now

    clock = Clock()
    monkeypatch.setattr(module, "time", clock)
    return clock


def watch(clock, *, terminal: bool) -> str:
    out = io.StringIO()
    console = Console(file=out, width=120, force_terminal=terminal, color_system=None)
    with LiveProgress(console) as live:
        live.begin(JOBS, 3)
        for job in JOBS:
            live.progress(job, Progress("loading"))
        for frames in (1, 51):
            live.progress(JOBS[0], Progress("exploring", frames, 201, 12.5))
            clock.now += 10.0
        live._display.refresh()
        live.ended(Outcome(JOBS[0]))
        live.ended(Outcome(JOBS[1], "RuntimeError: [lost] the way"))
    return out.getvalue()


def test_on_a_terminal_bars_frames_coverage_and_the_time_left(clock):
    text = watch(clock, terminal=True)
    assert "51/201" in text and "C.R.  12.5 %" in text and "exploring" in text and "all runs" in text
    # 50 frames took 10 seconds, 150 are left.
    assert "0:30 left" in text


@pytest.mark.parametrize("terminal", [True, False])
def test_ended_jobs_stay_with_their_fate_and_odd_names_are_shown_as_they_are(clock, terminal):
    text = watch(clock, terminal=terminal)
    assert "✓ room · random · seed 0  51/201 frames  C.R.  12.5 %  20 s" in text
    assert "✗ room · my[policy] · seed 0  RuntimeError: [lost] the way" in text


def test_elsewhere_nothing_but_what_ended_is_printed(clock):
    before, *ended = watch(clock, terminal=False).splitlines()
    assert before == "3 finished before, 2 to run"
    # One of two took 20 seconds.
    assert len(ended) == 2 and ended[0].endswith("1/2, 0:20 left") and "left" not in ended[1]


def test_a_log_is_never_silent_for_long(monkeypatch):
    monkeypatch.setattr(module, "_QUIET", 0.05)
    out = io.StringIO()
    with LiveProgress(Console(file=out, width=200)) as live:
        live.begin(JOBS, 0)
        time.sleep(0.3)
        live.progress(JOBS[1], Progress("exploring", 150, 201, 12.5))
        time.sleep(0.3)
    said = out.getvalue()
    assert "0/2 done, 0 s: starting" in said
    assert "room · my[policy] · seed 0  150/201  C.R.  12.5 %  exploring" in said
    assert len(said.splitlines()) < 15
    time.sleep(0.2)
    assert out.getvalue() == said


def test_the_time_left_does_not_count_what_was_finished_before(clock):
    live = LiveProgress(Console(file=io.StringIO()))
    live.begin(JOBS, 98)
    clock.now += 10.0
    live.ended(Outcome(JOBS[0]))
    assert live._update_whole() == pytest.approx(10.0)


def test_a_lost_attempt_is_told_and_counts_as_nothing_done(clock):
    out = io.StringIO()
    live = LiveProgress(Console(file=out, width=120))
    live.begin(JOBS, 0)
    live.progress(JOBS[1], Progress("exploring", 150, 201))
    live.on_retry(JOBS[1], "killed by signal 9")
    assert "↻ room · my[policy] · seed 0  killed by signal 9; will be tried again" in out.getvalue()
    assert live._update_whole() is None  # no speed is known


@pytest.mark.parametrize("terminal", [True, False])
def test_a_log_hears_of_every_kind_of_work_and_then_every_half_minute(clock, monkeypatch, terminal):
    monkeypatch.setattr(output, "time", clock)
    out = io.StringIO()
    console = Console(file=out, width=120, force_terminal=terminal, color_system=None)
    with output.working(console, "loading") as say:
        for number in range(10):
            say(f"compiling [all]: {number} so far")
            clock.now += 7.0
        say("compiled 10")
    lines = ["loading", *(f"compiling [all]: {number} so far" for number in (0, 5)), "compiled 10"]
    assert terminal or out.getvalue().splitlines() == lines
    assert not terminal or "compiled 10" not in out.getvalue().splitlines()
