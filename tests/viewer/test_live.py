"""A live episode: who may ask, what comes, and that commands are obeyed; then the page in a real browser."""

from __future__ import annotations

import html
import http.client
import json
import socket
import threading
import time
import urllib.error
import urllib.request
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pytest

from activestructure_gym.config import configure
from activestructure_gym.errors import InputError
from activestructure_gym.ground_truth import ground_truth_of
from activestructure_gym.reconstruction import Reconstruction
from activestructure_gym.scenes import load_scene
from activestructure_gym.viewer import LiveView, server
from tests.browser import BROWSER, open_page

SMALL = {"sensor": {"width": 64, "height": 36}, "keyframe_every": 5, "frame_budget": 80, "mapper.iterations": 1}


@pytest.fixture
def episode() -> Reconstruction:
    run = Reconstruction(configure("fast", {**SMALL, "features": ("pixel",)}))
    run.start(ground_truth_of(load_scene("box")), 0)
    return run


@pytest.fixture
def view(request: pytest.FixtureRequest) -> Iterator[LiveView]:
    served = LiveView("a test", **getattr(request, "param", {}))
    yield served
    served.close()


def ask(view: LiveView, path: str, *, key: str | None = None, body: Any = None, **headers: str) -> tuple[int, bytes]:
    place = urlsplit(view.url)
    known = place.query.removeprefix("key=") if key is None else key
    link = f"http://{place.netloc}{path}{'&' if '?' in path else '?'}key={known}"
    data = None if body is None else body if isinstance(body, bytes) else json.dumps(body).encode()
    try:
        with urllib.request.urlopen(urllib.request.Request(link, data, headers), timeout=30) as answer:
            return answer.status, answer.read()
    except urllib.error.HTTPError as error:
        return error.code, error.read()


def news(view: LiveView, episode: int = -1, moments: int = 0, version: int = -1) -> dict[str, Any]:
    status, body = ask(view, f"/news?episode={episode}&moments={moments}&version={version}")
    assert status == 200
    whole = zlib.decompress(body)
    length = int.from_bytes(whole[:4], "little")
    header = dict(json.loads(whole[4 : 4 + length]))
    for name, place in header["arrays"].items():
        count = int(np.prod(place["shape"]))
        header["arrays"][name] = np.frombuffer(whole, place["type"], count, 4 + length + place["at"])
    return header


def test_only_who_knows_the_link_is_answered(view: LiveView) -> None:
    assert view.url.startswith("http://127.0.0.1:")
    status, page = ask(view, "/")
    assert status == 200 and "connect-src 'self'" in html.unescape(page.decode())
    wrong = [
        {"key": ""}, {"key": "x" * 22}, {"key": "\N{SNOWMAN}".encode().hex()}, {"Host": "evil.example"},
        {"Origin": "http://evil.example"},
    ]  # fmt: skip
    for given in wrong:
        assert ask(view, "/", **given)[0] == 403
        assert ask(view, "/do", body={"do": "pause"}, **given)[0] == 403
    assert not view._paused
    assert ask(view, "/elsewhere")[0] == 404
    assert ask(view, "/news?episode=one")[0] == 400


@pytest.mark.parametrize(
    ("body", "status"),
    [(b"[" * 900, 400), (b"x" * 2000, 400), ([], 400), ({"do": "fly"}, 409), ({"do": "pace", "seconds": 1e9}, 409),
     ({"do": "pace", "seconds": True}, 409),
     ({"do": "visit", "row": 0, "episode": 1, "moment": 0}, 409)],
)  # fmt: skip
def test_commands_that_are_none_are_refused(view: LiveView, body: Any, status: int) -> None:
    assert ask(view, "/do", body=body)[0] == status


def test_a_page_gets_all_and_then_what_is_new(view: LiveView, episode: Reconstruction) -> None:
    view.begin(episode, "pixel")
    view.show()
    first = news(view)
    assert (first["episode"], first["first"], first["feature"], first["budget"]) == (1, 0, "pixel", 80)
    assert len(first["arrays"]["added"]) == episode.mapper.map.count
    assert len(first["arrays"]["poses"]) == 9 and first["chosen"] == [-1] and len(first["steps"]) == 1
    row = 2
    goal = episode.candidates.world_from_camera[row]
    view.chosen(row)
    episode.move_to(row)
    view.show("exploring")
    later = news(view, 1, 1, first["version"])
    poses = later["arrays"]["poses"].reshape(-1, 9)
    assert later["first"] == 1 and later["chosen"] == [row, -1] and len(poses) == len(episode.trajectory) - 1
    np.testing.assert_allclose(poses[-1, :3], goal[:3, 3], atol=1e-6)
    assert later["arrays"]["frames"].tolist() == [episode.frames] and later["curve"][0]["frames"] == episode.frames
    assert 0 < first["curve"][0]["known"] < later["curve"][0]["known"] <= 100
    again = news(view)  # a page that was opened later
    assert again["first"] == 0 and len(again["arrays"]["frames"]) == 2
    assert len(again["arrays"]["poses"]) == 9 * len(episode.trajectory)
    # Another episode begins: whoever watched the first one gets the second one whole.
    episode.start(ground_truth_of(load_scene("box")), 1)
    view.begin(episode)
    view.show()
    other = news(view, 1, 2, again["version"])
    assert (other["episode"], other["first"], len(other["arrays"]["frames"])) == (2, 0, 1)


def test_an_ungrown_episode_answers_with_nothing_new_after_a_while(
    view: LiveView, episode: Reconstruction, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("activestructure_gym.viewer.live._PATIENCE_S", 0.1)
    for begin in (lambda: None, lambda: view.begin(episode)):
        begin()
        began = time.monotonic()
        assert ask(view, "/news?version=-1") == (204, b"")  # the scene is being loaded
        assert time.monotonic() - began >= 0.1
    view.show()
    assert ask(view, f"/news?episode=1&moments=1&version={view._version}") == (204, b"")


def waiting(view: LiveView) -> tuple[threading.Thread, list[int | None]]:
    rows: list[int | None] = []
    thread = threading.Thread(target=lambda: rows.append(view.wait()))
    thread.start()
    return thread, rows


@pytest.mark.parametrize("view", [{"chooses": True, "paused": True}], indirect=True)
def test_paused_it_goes_on_by_steps_and_where_it_is_sent(view: LiveView, episode: Reconstruction) -> None:
    view.begin(episode)
    view.show()
    thread, rows = waiting(view)
    thread.join(0.1)
    assert thread.is_alive() and news(view)["state"] == "paused"
    assert ask(view, "/do", body={"do": "step"})[0] == 200
    thread.join(5)
    assert rows == [None]  # one decision, the policy's own
    thread, rows = waiting(view)
    for row, moment, status in ((10**6, 0, 409), (True, 0, 409), (3, False, 409), (3, 7, 409), (3, 0, 200)):
        assert ask(view, "/do", body={"do": "visit", "row": row, "episode": 1, "moment": moment})[0] == status
    thread.join(5)
    assert rows == [3]
    assert ask(view, "/do", body={"do": "go"})[0] == 200
    assert view.wait() is None and view.wait() is None
    ask(view, "/do", body={"do": "pace", "seconds": 1.0})
    began = time.monotonic()
    view.wait()
    assert time.monotonic() - began > 0.9


@pytest.mark.parametrize("view", [{"asks": True}], indirect=True)
def test_a_click_while_the_agent_walks_is_not_of_the_next_decision(view: LiveView, episode: Reconstruction) -> None:
    view.begin(episode)
    view.show()
    visit = {"do": "visit", "row": 1, "episode": 1, "moment": 0}
    assert ask(view, "/do", body=visit)[0] == 200  # between the picture and the question
    assert view.wait() == 1
    view.chosen(1)
    assert ask(view, "/do", body=visit | {"row": 2}) == (409, b"this decision has been made")
    episode.move_to(1)
    view.show()
    thread, rows = waiting(view)
    thread.join(0.2)
    assert thread.is_alive()
    assert ask(view, "/do", body=visit | {"row": 0, "moment": 1})[0] == 200
    thread.join(5)
    assert rows == [0]


def test_a_page_that_stays_open_is_let_go_when_the_view_is_closed(view: LiveView) -> None:
    place = urlsplit(view.url)
    page = http.client.HTTPConnection(place.netloc, timeout=10)
    page.request("GET", f"/?{place.query}")
    assert page.getresponse().read() and page.sock is not None
    view.close()
    page.request("GET", f"/news?{place.query}&version={view._version}")
    answer = page.getresponse()
    assert (answer.status, answer.getheader("Connection")) == (204, "close")


@pytest.mark.parametrize(
    ("request_", "status"),
    [(b"GET http://[ HTTP/1.1\r\n\r\n", 403), (b"POST /do HTTP/1.1\r\nContent-Length: \xb2\r\n\r\n", 400),
     (b"POST /do HTTP/1.1\r\nTransfer-Encoding: chunked\r\n\r\n0\r\n\r\n", 400),
     (b"GET /%00/../etc/passwd HTTP/1.1\r\n\r\n", 403)],
)  # fmt: skip
def test_what_is_no_request_is_refused_without_a_traceback(
    view: LiveView, request_: bytes, status: int, capsys: pytest.CaptureFixture[str]
) -> None:
    with socket.create_connection(view._server.server_address[:2], timeout=10) as line:  # type: ignore[arg-type]
        line.sendall(request_)
        line.shutdown(socket.SHUT_WR)
        assert line.makefile("rb").readline().split()[1] == str(status).encode()
    assert capsys.readouterr().err == ""


def test_who_has_no_key_is_told_no_version_and_holds_few_threads(view: LiveView) -> None:
    place = urlsplit(view.url)
    answer = http.client.HTTPConnection(place.netloc, timeout=10)
    answer.request("GET", "/")
    assert answer.getresponse().getheader("Server") == "asg"
    most, half = server._MAX_STRANGERS, []
    for _ in range(2 * most):
        half.append(socket.create_connection(view._server.server_address[:2], timeout=10))  # type: ignore[arg-type]
        half[-1].sendall(b"GET / HTTP/1.1\r\n")
    assert ask(view, "/")[0] == 200  # who has the key is answered
    assert half[0].recv(1) == b""  # the oldest has made room
    assert len(view._server._strangers) <= most
    until = time.monotonic() + 10.0  # threads of closed connections end soon after
    while (held := sum("process_request" in thread.name for thread in threading.enumerate())) > most + 5:
        assert time.monotonic() < until, held
        time.sleep(0.02)
    for line in half:
        line.close()


@pytest.mark.parametrize("view", [{"asks": True}], indirect=True)
def test_who_is_asked_is_waited_for_until_the_view_is_closed(view: LiveView, episode: Reconstruction) -> None:
    view.begin(episode)
    view.show()
    thread, rows = waiting(view)
    thread.join(0.1)
    assert thread.is_alive() and news(view)["state"].startswith("your turn")
    view.close()
    thread.join(5)
    assert rows == [None]


def test_nobody_is_asked_for_the_name_of_this_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    def asked(*_: Any) -> None:
        raise AssertionError("the network was asked")

    monkeypatch.setattr(socket, "getfqdn", asked)
    LiveView("a test").close()


def test_at_the_port_that_browsers_leave_away_it_is_known_without_one(monkeypatch: pytest.MonkeyPatch) -> None:
    class Server:
        """Port 80 belongs to root."""

        server_address = ("127.0.0.1", 80)

        def __init__(self, place: tuple[str, int], view: LiveView) -> None:
            pass

        def serve_forever(self, poll_interval: float) -> None:
            pass

    monkeypatch.setattr("activestructure_gym.viewer.live.Server", Server)
    assert LiveView("box", port=80).hosts == {"127.0.0.1", "127.0.0.1:80", "localhost", "localhost:80"}
    Server.server_address = ("127.0.0.1", 8080)
    assert LiveView("box", port=8080).hosts == {"127.0.0.1:8080", "localhost:8080"}


def test_what_cannot_be_served_is_said() -> None:
    taken = LiveView("a test")
    port = urlsplit(taken.url).port
    for given in ({"address": "nowhere"}, {"port": 70000}, {"port": port}, {"address": "203.0.113.7"}):
        with pytest.raises(InputError, match=r"cannot serve at .*127\.0\.0\.1 with port 0"):
            LiveView("a test", **given)
    taken.close()


@pytest.mark.slow
@pytest.mark.skipif(BROWSER is None, reason="there is no Chromium here")
@pytest.mark.parametrize("view", [{"asks": True}], indirect=True)
def test_a_click_on_a_candidate_moves_the_agent(view: LiveView, episode: Reconstruction, tmp_path: Path) -> None:
    view.begin(episode, "pixel")
    view.show()
    thread, rows = waiting(view)
    with open_page(view.url, tmp_path, width=900, height=600) as page:
        page.until("window.player && player.drawn > 0 && player.dirty === false")
        page.until("document.getElementById('state').textContent.startsWith('your turn')")
        first = page.picture()
        assert first.std() > 10
        # Where on the screen some candidate is drawn, as `under` finds it.
        found = page.value("""(() => {
            const run = player.runs[0], box = run.canvas.getBoundingClientRect();
            for (let y = Math.ceil(box.top); y < box.bottom - 40; y += 5) for (let x = 40; x < box.right - 40; x += 5) {
                const row = player.under(run, { clientX: x, clientY: y });
                if (row > 0) return [row, x, y];
            }
        })()""")
        page.click(*found[1:])
        thread.join(10)
        assert rows == [found[0]]
        goal = episode.candidates.world_from_camera[found[0]][:3, 3]
        view.chosen(found[0])
        episode.move_to(found[0])
        view.show()
        page.until(f"player.clock === {episode.frames} && player.dirty === false")
        np.testing.assert_allclose(page.value("player.runs[0].pose(player.clock).position"), goal, atol=1e-5)
        assert page.value("player.runs[0].scene.drawn") == len(view._recorder.film().added)  # type: ignore[union-attr]
        last = page.picture()
        assert (np.abs(first.astype(int) - last) > 20).mean() > 0.01
        page.value("player.scrub(1)")
        page.until("player.dirty === false")
        back = page.picture()
        assert (np.abs(back.astype(int) - last) > 20).mean() > 0.01
        page.value("document.getElementById('now').click(), 1")
        page.until(f"player.clock === {episode.frames} && player.dirty === false")
        view.end()
        page.until("document.getElementById('state').textContent === 'ended'")
        images = page.value(
            "window.revoked = 0, URL.revokeObjectURL = () => { revoked++; }, player.runs[0].images.size"
        )
        episode.start(ground_truth_of(load_scene("box")), 1)
        view.begin(episode)
        assert view._recorder is not None
        history = view._recorder._history
        history.gone.append((history.parameters[:, :7], history.ids[:7], 1))  # seven were there and have gone
        view.show()
        page.until("player.runs[0].film.episode === 2 && player.dirty === false")
        facts = page.value("player.runs[0].facts.textContent")
        assert f" {episode.mapper.map.count:,} Gaussians " in facts
        page.until("document.getElementById('state').textContent === 'exploring'")
        assert page.value("document.querySelectorAll('.stage').length") == 1
        assert page.value("revoked") == images > 0
        assert page.errors == []
    assert view._recorder is not None
