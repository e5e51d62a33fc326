"""``asg watch``: what it prints, and an episode that somebody leads."""

from __future__ import annotations

import json
import threading
import time
import urllib.error
import urllib.request
from typing import Any

import numpy as np
import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.cli import main
from activestructure_gym.evaluation.cli.watch import YOU, play
from activestructure_gym.policies import make_env_and_policy
from activestructure_gym.viewer import LiveView

SMALL = ["sensor.width=64", "sensor.height=36", "mapper.iterations=1"]


def test_it_prints_a_link_plays_and_leaves(capsys: pytest.CaptureFixture[str]) -> None:
    command = ["watch", "--scene", "box", "--policy", "random", "--preset", "fast", "--frames", "20", "--set", *SMALL]
    assert main([*command, "--exit"]) == 0
    told = capsys.readouterr()
    assert "http://127.0.0.1:" in told.out and "The episode has ended: 20 frames" in told.out and told.err == ""
    assert main([*command, "--exit", "--host", "0.0.0.0"]) == 0
    assert "everyone who reaches 0.0.0.0 and has the link can watch and steer" in capsys.readouterr().err
    for wrong, message in (
        (["--policy", "nobody"], "unknown policy 'nobody'"),
        (["--host", "here"], "cannot serve at"),
        (["--port", "99999"], "port 99999: bind(): port must be 0-65535; 127.0.0.1"),
        (["--scene", "nowhere"], "nowhere"),
        (["--scene", ","], "--scene names a scene to explore, got ','"),
        (["--world", "nowhere"], "unknown world 'nowhere'"),
    ):
        assert main([*command, *wrong]) == 2
        assert message in capsys.readouterr().err


def test_a_world_is_watched_like_a_scene(capsys: pytest.CaptureFixture[str]) -> None:
    world = "simulated?scene=box&width=64&height=36"
    assert main(["watch", "--world", world, "--policy", "random", "--preset", "fast", "--frames", "20", "--exit"]) == 0
    assert "m³ known, no ground truth" in capsys.readouterr().out


def test_a_choice_that_is_no_row_is_refused() -> None:
    env, policy = make_env_and_policy("random", "box", preset="rl", frame_budget=20)
    policy.act = lambda observation: 3.7  # type: ignore[method-assign, assignment, return-value]
    view = LiveView("a test")
    with pytest.raises(InputError, match="policy 'mine:Half': act.. must return a row, .* got 3.7"):
        play(env, policy, "mine:Half", 0, view, lambda text: None)
    view.close()


def test_you_are_asked_for_every_view_and_the_agent_goes_there() -> None:
    options: dict[str, Any] = {"preset": "fast", "frame_budget": 40, "config": {"sensor": {"width": 64, "height": 36}}}
    env, policy = make_env_and_policy("hole_area", "box", **options)
    view = LiveView("a test", asks=True)
    sent: list[int] = []

    def click() -> None:
        """The last candidate of every decision."""
        link = view.url.replace("/?", "/do?")
        while not view._ended:
            with view._news:
                moments = view._recorder.moments if view._recorder else []
                moment, row = len(moments) - 1, len(moments[-1].candidates) - 1 if moments else -1
            body = json.dumps({"do": "visit", "row": row, "episode": 1, "moment": moment}).encode()
            try:
                urllib.request.urlopen(urllib.request.Request(link, body), timeout=10).close()
            except urllib.error.HTTPError:
                continue
            while len(view._recorder.moments) == moment + 1 and not view._ended:  # type: ignore[union-attr]
                time.sleep(0.01)
            sent.append(row)

    clicker = threading.Thread(target=click)
    clicker.start()
    told = play(env, policy, YOU, 0, view, lambda text: None)
    clicker.join(10)
    film = view._recorder.film()  # type: ignore[union-attr]
    view.close()
    assert told.startswith("40 frames") and film.moments[-1].frame == 40
    assert [moment.row for moment in film.moments[:-1]] == [len(m.candidates) - 1 for m in film.moments[:-1]]
    # The same rows without anybody watching are the same episode.
    other, _ = make_env_and_policy("hole_area", "box", **options)
    other.reset(seed=0)
    for moment in film.moments[:-1]:
        other.step(np.int64(moment.row))
    np.testing.assert_array_equal(np.array(other.unwrapped.reconstruction.trajectory), film.poses)  # type: ignore[attr-defined]
