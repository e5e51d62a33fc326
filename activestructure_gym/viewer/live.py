"""An episode as it happens, served to a browser on this machine, which may pause it and say where to go next."""

from __future__ import annotations

import json
import os
import re
import secrets
import socket
import sys
import threading
import time
import zlib
from contextlib import suppress
from functools import partial
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from ipaddress import ip_address
from socketserver import TCPServer
from typing import TYPE_CHECKING, Any
from urllib.parse import parse_qs, urlsplit

import numpy as np

from activestructure_gym.errors import InputError, shown
from activestructure_gym.viewer.packing import film_parts, packed
from activestructure_gym.viewer.page import viewer_page
from activestructure_gym.viewer.recorder import Recorder

if TYPE_CHECKING:
    from activestructure_gym.reconstruction import Reconstruction

LOOPBACK = "127.0.0.1"
_PATIENCE_S = 15.0  # a question for news waits so long before it is answered that there is none
_LONGEST = 1000  # bytes of a command
_MOST_STRANGERS = 64  # connections that have not shown the key; the oldest makes room for the next
PACES = (0.0, 1.0, 3.0)  # seconds between two decisions that can be chosen
_ZLIB_LEVEL = 1  # it is the same machine


class LiveView:
    """A page that shows an episode while it is played.

    Whoever plays calls `begin` once per episode, `show` before every decision, and `wait`, which returns when the
    episode may go on, with the row that was clicked, if one was. The page is served at ``url``, which holds a key: who
    does not know it can neither look nor steer.

    Parameters
    ----------
    title
        What stands above the picture.
    address
        Where it is served; 127.0.0.1 is this machine alone.
    port
        0 is a free one.
    chooses
        Whether a candidate can be clicked: `wait` then returns rows.
    asks
        Whether nothing happens until one is clicked.
    paused
        Whether it begins paused.

    Raises `InputError` where it cannot be served there.
    """

    def __init__(
        self,
        title: str,
        *,
        address: str = LOOPBACK,
        port: int = 0,
        chooses: bool = False,
        asks: bool = False,
        paused: bool = False,
    ) -> None:
        self.title, self.chooses, self.asks = title, chooses or asks, asks
        self._key = secrets.token_urlsafe(16)
        self._news = threading.Condition()  # guards all below
        self._version = 0  # grows with everything that can be seen
        self._episode = 0
        self._recorder: Recorder | None = None
        self._told: dict[str, Any] = {}
        self._state = "exploring"
        self._paused, self._ended, self._closed = paused, False, False
        self._steps = 0  # decisions that may be made although it is paused
        self._pace = 0.0  # seconds between decisions
        self._open = False  # whether the last decision can still be made by a click
        self._row: int | None = None  # that was clicked
        try:
            ip_address(address)
            self._server = _Server((address, port), self)
        except (OSError, OverflowError, ValueError) as error:
            raise InputError(
                f"nothing can be served at {shown(address)} port {shown(port)}: {error}. 127.0.0.1 and port 0, a free "
                "one, always can"
            ) from None
        host, port = str(self._server.server_address[0]), self._server.server_address[1]
        host = f"[{host}]" if ":" in host else host
        # Browsers leave the port away where it is HTTP's own.
        names = {f"{name}{end}" for name in (host, "localhost") for end in (f":{port}", *[""] * (port == 80))}
        self.hosts = names if ip_address(address).is_loopback else None
        self.url = f"http://{host}:{port}/?key={self._key}"
        serve = partial(self._server.serve_forever, poll_interval=0.02)  # seconds that closing waits
        threading.Thread(target=serve, name="live view", daemon=True).start()

    def begin(self, episode: Reconstruction, worth: str = "") -> None:
        """An episode has begun; ``worth`` is the name of the feature that candidates are coloured by."""
        recorder = Recorder(episode)
        with self._news:
            self._recorder, self._episode, self._ended = recorder, self._episode + 1, False
            self._open, self._row = False, None
            self._told = {"worth": worth, "budget": episode.frame_budget, "curve": [], "steps": []}
        self._reconstruction = episode

    def show(self, phase: str | None = None) -> None:
        """There is something new: a decision is to be made, or the episode has ended."""
        episode = self._reconstruction
        assert self._recorder is not None, "begin() comes first"
        point = {"frames": episode.frames, "known": known_share(episode), "fidelity": fidelity(episode)}
        with self._news:
            self._recorder.note()
            self._open, self._row = True, None
            self._told["curve"].append(point)
            self._told["steps"].append({"phase": phase, "metres": round(episode.metres, 2)})
            self._changed("exploring")

    def chosen(self, row: int) -> None:
        """This candidate was chosen."""
        with self._news:
            if self._recorder is not None and self._recorder.moments:
                self._recorder.choose(row)
                self._changed("walking" if self.asks else "exploring")

    def wait(self) -> int | None:
        """Until the episode may go on; the row that was clicked, or None.

        From then on until the next `show` nothing can be clicked: rows are of one decision.
        """
        with self._news:
            self._open = not self._ended
            try:
                return self._waited()
            finally:
                self._open = False

    def _waited(self) -> int | None:
        """See `wait`; with the condition held."""
        due = time.monotonic() + self._pace
        while not self._closed:
            if self._row is not None:
                row, self._row = self._row, None
                return row
            if self.asks:
                self._set("your turn: click a candidate")
            elif self._paused and not self._steps:
                self._set("paused")
            elif time.monotonic() >= due:
                break
            # A bounded wait, so that Ctrl+C is heard.
            self._news.wait(0.5 if self._paused or self.asks else max(due - time.monotonic(), 0.001))
        self._steps = max(self._steps - 1, 0)
        return None

    def end(self, state: str = "ended") -> None:
        """The episode is over; the page stays as it is."""
        with self._news:
            self._ended, self._open = True, False
            self._changed(state)

    def close(self) -> None:
        """Serve no more; calling it twice does no harm."""
        with self._news:
            if self._closed:
                return
            self._closed = True
            self._changed("closed")
        self._server.shutdown()
        self._server.server_close()

    def _set(self, state: str) -> None:
        if state != self._state:
            self._changed(state)

    def _changed(self, state: str) -> None:
        self._state = state
        self._version += 1
        self._news.notify_all()

    # -- what the page asks ----------------------------------------------------------------------------------------

    def page(self) -> str:
        """The page itself."""
        return viewer_page(self.title, live=True)

    @property
    def closed(self) -> bool:
        """Whether nothing is served any more."""
        return self._closed

    def knows(self, key: str) -> bool:
        """Whether this is the key."""
        return secrets.compare_digest(key.encode(), self._key.encode())

    def news(self, episode: int, moments: int, version: int) -> bytes | None:
        """What the page does not have yet, deflated; None if nothing comes for a while."""
        with self._news:
            self._news.wait_for(lambda: self._closed or self._is_news(version), _PATIENCE_S)
            recorder = self._recorder
            if recorder is None or not self._is_news(version):
                return None
            begins = episode != self._episode
            first = 0 if begins or not 0 <= moments <= len(recorder.moments) else moments
            film = recorder.film(first)
            head = {
                "title": self.title,
                "episode": self._episode,
                "first": first,
                "version": self._version,
                "state": self._state,
                "paused": self._paused,
                "ended": self._ended,
                "chooses": self.chooses and not self._ended,
                "pace": self._pace,
                "chosen": [moment.row for moment in recorder.moments],
                **{name: self._told[name][first:] for name in ("curve", "steps")},
                **{name: self._told[name] for name in ("worth", "budget")},
                "differs": "",
            }
        arrays, told = film_parts(film)
        return zlib.compress(packed(arrays, head | told), _ZLIB_LEVEL)

    def _is_news(self, version: int) -> bool:
        return self._version != version and self._recorder is not None and bool(self._recorder.moments)

    def obey(self, command: dict[str, Any]) -> str:
        """Do what the page asks for; what is wrong with it, or nothing."""
        with self._news:
            kind, recorder = command.get("do"), self._recorder
            if kind == "pause":
                self._paused = True
            elif kind == "go":
                self._paused, self._steps = False, 0
            elif kind == "step":
                self._paused, self._steps = True, self._steps + 1
            elif kind == "pace" and not isinstance(command.get("seconds"), bool) and command.get("seconds") in PACES:
                self._pace = float(command["seconds"])
            elif kind == "visit" and self.chooses and recorder is not None and recorder.moments:
                row, moment = command.get("row"), len(recorder.moments) - 1
                if any(isinstance(command.get(name), bool) for name in ("row", "episode", "moment")):
                    return "whole numbers are expected"
                if command.get("episode") != self._episode or command.get("moment") != moment or not self._open:
                    return "this decision has been made"
                if not isinstance(row, int) or not 0 <= row < len(recorder.moments[moment].candidates):
                    return "there is no such candidate"
                self._row = row
            else:
                return "there is no such command"
            self._changed(self._state if self._ended else "paused" if self._paused and not self._steps else "exploring")
            return ""


def known_share(episode: Reconstruction) -> float:
    """Percent of the workspace's voxels that are known to be free or occupied."""
    return round(100.0 * float(1.0 - episode.volume.unobserved[1:-1, 1:-1, 1:-1].mean()), 2)


def fidelity(episode: Reconstruction) -> float:
    """Median PSNR over the keyframes, each as it was measured last, in decibel."""
    return round(float(np.median(episode.mapper.keyframe_psnr(renders=0))), 2)


class _Server(ThreadingHTTPServer):
    """Many pages may ask at once, and none of them keeps the program alive."""

    daemon_threads = True
    request_queue_size = 128  # connections that wait to be accepted
    allow_reuse_address = os.name != "nt"  # Windows would let a second program serve at a port that is taken

    def __init__(self, place: tuple[str, int], view: LiveView) -> None:
        self.address_family = socket.AF_INET6 if ":" in place[0] else socket.AF_INET
        self.view = view
        self._strangers: dict[Any, None] = {}  # connections that have not shown the key, the oldest first
        self._counting = threading.Lock()
        super().__init__(place, _Handler)

    def process_request(self, request: Any, client_address: Any) -> None:
        """Answer on a thread; where too many connections have not shown the key, close the oldest of them."""
        with self._counting:
            self._strangers[request] = None
            oldest = next(iter(self._strangers)) if len(self._strangers) > _MOST_STRANGERS else None
        if oldest is not None:
            self.admit(oldest)
            with suppress(OSError):
                oldest.shutdown(socket.SHUT_RDWR)  # its thread reads the end
        super().process_request(request, client_address)

    def admit(self, request: Any) -> None:
        """Count a connection no more among those that have not shown the key."""
        with self._counting:
            self._strangers.pop(request, None)

    def close_request(self, request: Any) -> None:
        """Close a connection."""
        self.admit(request)
        super().close_request(request)

    def server_bind(self) -> None:
        """Without asking the network for this machine's name, which can take long and is not needed."""
        TCPServer.server_bind(self)
        self.server_name, self.server_port = str(self.server_address[0]), int(self.server_address[1])

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A page that was closed while it was answered is no error."""
        if not isinstance(sys.exc_info()[1], ConnectionError | TimeoutError):
            super().handle_error(request, client_address)


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    server: _Server
    timeout = 15  # seconds without a request after which a connection is let go

    def do_GET(self) -> None:
        """The page, and what is new."""
        path, asked = self._asked()
        if not self._admitted(asked):
            return
        if path == "/":
            self._answer(HTTPStatus.OK, self.server.view.page().encode(), "text/html; charset=utf-8")
        elif path == "/news":
            try:
                numbers = [int(asked.get(name, -1)) for name in ("episode", "moments", "version")]
            except ValueError:
                return self._answer(HTTPStatus.BAD_REQUEST, b"whole numbers are expected")
            news = self.server.view.news(*numbers)
            status = HTTPStatus.NO_CONTENT if news is None else HTTPStatus.OK
            self._answer(status, news or b"", "application/octet-stream")
        else:
            self._answer(HTTPStatus.NOT_FOUND, b"there is nothing here")

    def do_POST(self) -> None:
        """A command."""
        path, asked = self._asked()
        length = self.headers.get("Content-Length", "")
        if not re.fullmatch("[0-9]{1,9}", length) or int(length) > _LONGEST:
            self.close_connection = True
            return self._answer(HTTPStatus.BAD_REQUEST, b"a command is short")
        body = self.rfile.read(int(length))
        if not self._admitted(asked):
            return
        try:
            command = json.loads(body)
        except (RecursionError, ValueError):
            command = None
        if path != "/do" or not isinstance(command, dict):
            return self._answer(HTTPStatus.BAD_REQUEST, b"there is no such command")
        wrong = self.server.view.obey(command)
        self._answer(HTTPStatus.CONFLICT if wrong else HTTPStatus.OK, wrong.encode())

    def _asked(self) -> tuple[str, dict[str, str]]:
        """The path and what stands behind the question mark; nothing of an address that is none."""
        try:
            place = urlsplit(self.path)
        except ValueError:
            return "", {}
        return place.path, {name: values[-1] for name, values in parse_qs(place.query).items()}

    def _admitted(self, asked: dict[str, str]) -> bool:
        """Whether who asks knows the key and asks for this server by its own name.

        A page from elsewhere that a name was rebound for would ask for another host.
        """
        view, host, origin = self.server.view, self.headers.get("Host", ""), self.headers.get("Origin")
        known = view.hosts is None or host in view.hosts
        if known and origin in (None, f"http://{host}") and view.knows(asked.get("key", "")):
            self.server.admit(self.connection)
            return True
        self._answer(HTTPStatus.FORBIDDEN, b"open the address that was printed, with its key")
        return False

    def _answer(self, status: HTTPStatus, body: bytes, kind: str = "text/plain; charset=utf-8") -> None:
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(body)))
        self.send_header("Cache-Control", "no-store")
        self.send_header("Referrer-Policy", "no-referrer")  # the address holds the key
        self.send_header("X-Content-Type-Options", "nosniff")
        if self.server.view.closed:  # or a page would go on asking, at once, for as long as the program lives
            self.send_header("Connection", "close")
        self.end_headers()
        self.wfile.write(body)

    def version_string(self) -> str:
        """Name the program, and no version: also who has no key is answered."""
        return "asg"

    def log_message(self, format: str, *args: Any) -> None:
        """Nobody reads it."""
