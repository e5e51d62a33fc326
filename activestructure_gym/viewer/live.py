"""Serve a running episode to a browser, in which the user can pause it and choose the next candidate."""

from __future__ import annotations

import secrets
import threading
import time
import zlib
from functools import partial
from ipaddress import ip_address
from typing import TYPE_CHECKING, Any

import numpy as np

from activestructure_gym.errors import InputError, short_repr
from activestructure_gym.viewer.packing import film_parts, packed
from activestructure_gym.viewer.page import viewer_page
from activestructure_gym.viewer.recorder import Recorder
from activestructure_gym.viewer.server import Server

if TYPE_CHECKING:
    from activestructure_gym.reconstruction import Reconstruction

LOOPBACK = "127.0.0.1"
_PATIENCE_S = 15.0  # seconds after which a request for new data gets an empty answer
PACES = (0.0, 1.0, 3.0)  # seconds between two decisions that the page offers
_ZLIB_LEVEL = 1  # the lowest level: server and browser run on the same machine


class LiveView:
    """Serve a page that shows an episode while it runs.

    The caller calls `begin` once per episode. Before every decision it calls `show` and then `wait`. `wait` returns
    when the episode may continue, and returns the clicked candidate, if any. The address of the page, ``url``, contains
    a key without which the server refuses every request.

    Parameters
    ----------
    title
        Heading of the page.
    address
        IP address to serve at; 127.0.0.1 is reachable from this machine only.
    port
        Port to serve at; 0 selects a free one.
    chooses
        Whether the user can choose a candidate by a click.
    asks
        Whether `wait` waits until the user has clicked a candidate; implies ``chooses``.
    paused
        Whether the episode starts paused.

    Raises
    ------
    InputError
        If the address or port cannot be used.
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
        self._news = threading.Condition()  # guards all attributes below
        self._version = 0  # increases with every change that the page shows
        self._episode = 0
        self._recorder: Recorder | None = None
        self._header: dict[str, Any] = {}
        self._state = "exploring"
        self._paused, self._ended, self._closed = paused, False, False
        self._steps = 0  # number of decisions that may be made while paused
        self._pace = 0.0  # seconds between decisions
        self._open = False  # whether a click can still choose the candidate of the current decision
        self._row: int | None = None  # index of the clicked candidate
        try:
            ip_address(address)
            self._server = Server((address, port), self)
        except (OSError, OverflowError, ValueError) as error:
            reason = getattr(error, "strerror", None) or str(error).rstrip(".")
            raise InputError(
                f"cannot serve at {short_repr(address)} port {short_repr(port)}: {reason}; 127.0.0.1 with port 0 (a "
                "free port) always works"
            ) from None
        host, port = str(self._server.server_address[0]), self._server.server_address[1]
        host = f"[{host}]" if ":" in host else host
        # Browsers omit HTTP's default port.
        names = {f"{name}{end}" for name in (host, "localhost") for end in (f":{port}", *[""] * (port == 80))}
        self.hosts = names if ip_address(address).is_loopback else None
        self.url = f"http://{host}:{port}/?key={self._key}"
        # close() waits at most this poll interval, in seconds.
        serve = partial(self._server.serve_forever, poll_interval=0.02)
        threading.Thread(target=serve, name="live view", daemon=True).start()

    def begin(self, episode: Reconstruction, feature: str = "") -> None:
        """Start showing an episode; ``feature`` is the name of the feature that colours the candidates."""
        recorder = Recorder(episode)
        with self._news:
            self._recorder, self._episode, self._ended = recorder, self._episode + 1, False
            self._open, self._row = False, None
            self._header = {"feature": feature, "budget": episode.frame_budget, "curve": [], "steps": []}
        self._reconstruction = episode

    def show(self, phase: str | None = None) -> None:
        """Show the state of the episode before a decision or at the end; ``phase`` is the planner's phase, if any."""
        episode = self._reconstruction
        assert self._recorder is not None, "begin() comes first"
        point = {"frames": episode.frames, "known": known_share(episode), "fidelity": fidelity(episode)}
        with self._news:
            self._recorder.note()
            self._open, self._row = True, None
            self._header["curve"].append(point)
            self._header["steps"].append({"phase": phase, "metres": round(episode.metres, 2)})
            self._changed("exploring")

    def chosen(self, row: int) -> None:
        """Show that the candidate with index ``row`` was chosen."""
        with self._news:
            if self._recorder is not None and self._recorder.moments:
                self._recorder.choose(row)
                self._changed("walking" if self.asks else "exploring")

    def wait(self) -> int | None:
        """Wait until the episode may continue; return the index of the clicked candidate, or None without a click.

        Clicks are accepted only while this method waits, because candidate indices are valid for one decision only.
        """
        with self._news:
            self._open = not self._ended
            try:
                return self._waited()
            finally:
                self._open = False

    def _waited(self) -> int | None:
        """Implement `wait`. The caller must hold the condition ``_news``."""
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
            # A limited wait, so that Ctrl+C is handled.
            self._news.wait(0.5 if self._paused or self.asks else max(due - time.monotonic(), 0.001))
        self._steps = max(self._steps - 1, 0)
        return None

    def end(self) -> None:
        """Show that the episode has ended. The page remains open."""
        with self._news:
            self._ended, self._open = True, False
            self._changed("ended")

    def close(self) -> None:
        """Stop the server. A second call does nothing."""
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

    # -- called by the request handler -------------------------------------------------------------------------------

    def page(self) -> str:
        """Return the page's HTML."""
        return viewer_page(self.title, live=True, asks=self.asks)

    @property
    def closed(self) -> bool:
        """Return whether the server is closed."""
        return self._closed

    def has_key(self, key: str) -> bool:
        """Return whether ``key`` is the server's key."""
        return secrets.compare_digest(key.encode(), self._key.encode())

    def news(self, episode: int, moments: int, version: int) -> bytes | None:
        """Return the data that the page lacks, compressed; None if nothing changes within 15 seconds.

        The page has the first ``moments`` recorded states of the episode with number ``episode``, at ``version``.
        """
        with self._news:
            self._news.wait_for(lambda: self._closed or self._is_news(version), _PATIENCE_S)
            recorder = self._recorder
            if recorder is None or not self._is_news(version):
                return None
            begins = episode != self._episode
            first = 0 if begins or not 0 <= moments <= len(recorder.moments) else moments
            film = recorder.film(first)
            head = {
                "name": "",
                "episode": self._episode,
                "first": first,
                "version": self._version,
                "state": self._state,
                "paused": self._paused,
                "ended": self._ended,
                "chooses": self.chooses and not self._ended,
                "pace": self._pace,
                "chosen": [moment.row for moment in recorder.moments],
                **{name: self._header[name][first:] for name in ("curve", "steps")},
                **{name: self._header[name] for name in ("feature", "budget")},
                "warning": "",
            }
        arrays, decoding = film_parts(film)
        return zlib.compress(packed(arrays, head | decoding), _ZLIB_LEVEL)

    def _is_news(self, version: int) -> bool:
        return self._version != version and self._recorder is not None and bool(self._recorder.moments)

    def execute(self, command: dict[str, Any]) -> str:
        """Execute a command sent by the page; return an error message, or an empty string if it was executed."""
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
    """Return the percentage of the voxels inside the workspace that are known to be free or occupied."""
    return round(100.0 * float(1.0 - episode.volume.unobserved[1:-1, 1:-1, 1:-1].mean()), 2)


def fidelity(episode: Reconstruction) -> float:
    """Return the median PSNR in dB over the keyframes, each with its most recently measured PSNR."""
    return round(float(np.median(episode.mapper.keyframe_psnr(renders=0))), 2)
