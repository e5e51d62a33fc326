"""Answer the HTTP requests of the page of a `LiveView`."""

from __future__ import annotations

import json
import os
import re
import socket
import sys
import threading
from contextlib import suppress
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from socketserver import TCPServer
from typing import Any, Protocol
from urllib.parse import parse_qs, urlsplit

_MAX_COMMAND_BYTES = 1000  # larger requests are refused
_MAX_STRANGERS = 64  # maximum number of connections that have not sent the key; the oldest is closed for a new one


class View(Protocol):
    """Define what the server needs of a `LiveView`."""

    hosts: set[str] | None  # host names of the server; None: any

    @property
    def closed(self) -> bool:
        """Return whether the server is closed."""
        ...

    def page(self) -> str:
        """Return the page's HTML."""
        ...

    def has_key(self, key: str) -> bool:
        """Return whether ``key`` is the server's key."""
        ...

    def news(self, episode: int, moments: int, version: int) -> bytes | None:
        """Return the data that the page lacks."""
        ...

    def execute(self, command: dict[str, Any]) -> str:
        """Execute a command of the page; return an error message, or an empty string."""
        ...


class Server(ThreadingHTTPServer):
    """Answer each HTTP request in its own thread; the threads end with the program."""

    daemon_threads = True
    request_queue_size = 128  # number of connections that may wait to be accepted
    allow_reuse_address = os.name != "nt"  # on Windows the option would let two programs use the same port

    def __init__(self, place: tuple[str, int], view: View) -> None:
        self.address_family = socket.AF_INET6 if ":" in place[0] else socket.AF_INET
        self.view = view
        self._strangers: dict[Any, None] = {}  # connections that have not sent the key, oldest first
        self._counting = threading.Lock()
        super().__init__(place, _Handler)

    def process_request(self, request: Any, client_address: Any) -> None:
        """Answer a connection in a new thread; close the oldest connection without the key if there are too many."""
        with self._counting:
            self._strangers[request] = None
            oldest = next(iter(self._strangers)) if len(self._strangers) > _MAX_STRANGERS else None
        if oldest is not None:
            self.admit(oldest)
            with suppress(OSError):
                oldest.shutdown(socket.SHUT_RDWR)  # ends the read on which its thread waits
        super().process_request(request, client_address)

    def admit(self, request: Any) -> None:
        """Remove a connection from the list of connections that have not sent the key."""
        with self._counting:
            self._strangers.pop(request, None)

    def close_request(self, request: Any) -> None:
        """Close a connection, and remove it from the list of connections that have not sent the key."""
        self.admit(request)
        super().close_request(request)

    def server_bind(self) -> None:
        """Bind the socket without looking up this machine's host name, which can be slow and is not needed."""
        TCPServer.server_bind(self)
        self.server_name, self.server_port = str(self.server_address[0]), int(self.server_address[1])

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore errors of connections that the browser closed; report all others."""
        if not isinstance(sys.exc_info()[1], ConnectionError | TimeoutError):
            super().handle_error(request, client_address)


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    server: Server
    timeout = 15  # seconds without a request before a connection is closed

    def do_GET(self) -> None:
        """Answer a GET request with the page (``/``) or with new data (``/news``)."""
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
        """Execute the command in the body of a POST request to ``/do``."""
        path, asked = self._asked()
        length = self.headers.get("Content-Length", "")
        if not re.fullmatch("[0-9]{1,9}", length) or int(length) > _MAX_COMMAND_BYTES:
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
        wrong = self.server.view.execute(command)
        self._answer(HTTPStatus.CONFLICT if wrong else HTTPStatus.OK, wrong.encode())

    def _asked(self) -> tuple[str, dict[str, str]]:
        """Return the path and the query parameters of the request; both are empty for an invalid address."""
        try:
            place = urlsplit(self.path)
        except ValueError:
            return "", {}
        return place.path, {name: values[-1] for name, values in parse_qs(place.query).items()}

    def _admitted(self, asked: dict[str, str]) -> bool:
        """Return whether a request has the key and addresses this server by its own host name; otherwise refuse it.

        The check of the host name prevents DNS rebinding: a foreign page whose host name resolves to this machine.
        """
        view, host, origin = self.server.view, self.headers.get("Host", ""), self.headers.get("Origin")
        known = view.hosts is None or host in view.hosts
        if known and origin in (None, f"http://{host}") and view.has_key(asked.get("key", "")):
            self.server.admit(self.connection)
            return True
        self._answer(HTTPStatus.FORBIDDEN, b"open the address that was printed, with its key")
        return False

    def _answer(self, status: HTTPStatus, body: bytes, kind: str = "text/plain; charset=utf-8") -> None:
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(body)))
        self.send_header("Cache-Control", "no-store")
        self.send_header("Referrer-Policy", "no-referrer")  # the address contains the key
        self.send_header("X-Content-Type-Options", "nosniff")
        # A page of a closed server would otherwise keep its connection and send more requests.
        if self.server.view.closed:
            self.send_header("Connection", "close")
        self.end_headers()
        self.wfile.write(body)

    def version_string(self) -> str:
        """Return the server name for answers, without a version, because requests without the key get answers too."""
        return "asg"

    def log_message(self, format: str, *args: Any) -> None:
        """Suppress the log of requests."""
