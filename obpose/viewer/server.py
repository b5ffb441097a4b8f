"""The viser server, restricted to requests of its own page and answering malformed HTTP requests properly.

Browsers let every open page connect to servers of this machine, and viser does not check the origin of requests. Its
websocket server, which also serves the page, drops requests that it cannot parse without an answer. A connection class
and hooks of the server fix both.
"""

import logging
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from http import HTTPStatus
from io import StringIO
from ipaddress import ip_address
from typing import Any
from urllib.parse import urlsplit

import viser
from websockets.asyncio import server as websockets_server
from websockets.asyncio.server import ServerConnection
from websockets.http11 import Request, Response
from websockets.streams import StreamReader

from obpose.errors import UsageError

MAX_URL = 2048
"""Longest URL, characters."""
MAX_HEAD = 32_768
"""Largest head of a request, bytes."""
_METHODS = {"GET", "HEAD", "OPTIONS"}
_ALLOW = "GET, HEAD, OPTIONS"

HEADERS = {
    "X-Frame-Options": "DENY",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    # viser's page is one self-extracting file: an inline script, workers from blobs, and WebAssembly whose bindings are
    # evaluated from strings. The policy therefore only forbids resources of, and connections to, other servers.
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self' 'unsafe-inline' 'unsafe-eval' blob:; style-src 'self' 'unsafe-inline'; "
        "img-src 'self' data: blob:; font-src 'self' data:; connect-src 'self' data: blob:; worker-src 'self' blob:; "
        "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
}
"""Security headers of every response."""


def open_server(host: str, port: int, title: str) -> viser.ViserServer:
    """Start a server at exactly this port."""
    with redirect_stdout(StringIO()), _guarded(host):
        server = viser.ViserServer(host=host, port=port, label=title, verbose=False)
    if server.get_port() != port:
        close_server(server)
        raise UsageError(f"Port {port} was taken meanwhile; give another --port.")
    return server


def close_server(server: viser.ViserServer) -> None:
    """Stop the server and close all its connections."""
    with redirect_stdout(StringIO()):
        server.stop()


def refusal(request: Request, bound: str) -> HTTPStatus | None:
    """Status with which to refuse a request; None if it may be answered.

    Requests from pages of other servers are refused; programs other than browsers send no origin. A server bound to the
    loopback address also refuses foreign host names, which indicate DNS rebinding.
    """
    origins, hosts = (request.headers.get_all(name) for name in ("Origin", "Host"))
    if len(hosts) != 1 or len(origins) > 1 or not _name_of(hosts[0]):
        return HTTPStatus.BAD_REQUEST
    if _is_local(bound) and not _is_local(_name_of(hosts[0])):
        return HTTPStatus.FORBIDDEN
    if origins and is_foreign(origins[0], hosts[0], bound):
        return HTTPStatus.FORBIDDEN
    return None


def is_foreign(origin: str, host: str, bound: str) -> bool:
    """Whether a request comes from a page of another server; a malformed origin is foreign."""
    try:
        parts = urlsplit(origin)
        return parts.netloc != host or (_is_local(bound) and not _is_local(parts.hostname))
    except ValueError:
        return True


def _name_of(host: str) -> str | None:
    """Name or address in `name:port`; None if it is malformed."""
    try:
        parts = urlsplit(f"//{host}")
        # `parts.port` raises ValueError if the port is no number.
        whole = parts.netloc == host and "@" not in host and (parts.port is None or parts.port > 0)
        return parts.hostname if whole else None
    except ValueError:
        return None


def _is_local(name: str | None) -> bool:
    try:
        return name == "localhost" or ip_address(name or "").is_loopback
    except ValueError:
        return False


class Connection(ServerConnection):
    """A connection that also answers the requests that `websockets` drops: other methods, and malformed requests."""

    method = "GET"
    _head = b""
    _head_done = False

    def data_received(self, data: bytes) -> None:
        """Check the head of the request before the library parses it."""
        if self._head_done:
            super().data_received(data)
            return
        self._head += data
        if b"\r\n\r\n" not in self._head and len(self._head) <= MAX_HEAD:
            return
        self._head_done = True
        method, status = read_head(self._head)
        if status is not None:
            self._refuse(status)
            return
        self.method = method
        super().data_received(self._head.replace(method.encode(), b"GET", 1))

    def _refuse(self, status: HTTPStatus) -> None:
        body = f"{status.phrase}.\n".encode()
        headers = {**HEADERS, "Content-Type": "text/plain", "Content-Length": str(len(body)), "Connection": "close"}
        if status is HTTPStatus.METHOD_NOT_ALLOWED:
            headers["Allow"] = _ALLOW
        lines = [f"HTTP/1.1 {status.value} {status.phrase}", *(f"{name}: {value}" for name, value in headers.items())]
        self.transport.write("\r\n".join([*lines, "", ""]).encode() + body)
        self.transport.close()


def read_head(head: bytes) -> tuple[str, HTTPStatus | None]:
    """Read the method of a request, and the status to refuse it with if the library cannot parse it."""
    line, _, rest = head.partition(b"\r\n")
    parts = line.decode("latin-1").split(" ")
    if len(parts) != 3 or not parts[2].startswith("HTTP/"):
        return "", HTTPStatus.REQUEST_URI_TOO_LONG if len(line) > MAX_URL else HTTPStatus.BAD_REQUEST
    method, url, version = parts
    if len(url) > MAX_URL:
        return method, HTTPStatus.REQUEST_URI_TOO_LONG
    if b"\r\n\r\n" not in head:
        return method, HTTPStatus.REQUEST_HEADER_FIELDS_TOO_LARGE
    if method not in _METHODS:
        return method, HTTPStatus.METHOD_NOT_ALLOWED
    if version != "HTTP/1.1":
        return method, HTTPStatus.HTTP_VERSION_NOT_SUPPORTED
    if not url.startswith("/") and not (method == "OPTIONS" and url == "*"):
        return method, HTTPStatus.BAD_REQUEST
    reader = StreamReader()
    reader.feed_data(b"GET " + line.partition(b" ")[2] + b"\r\n" + rest)
    try:
        next(Request.parse(reader.read_line))
    except StopIteration:
        return method, None
    except Exception:  # the library would drop the request
        pass
    return method, HTTPStatus.BAD_REQUEST


@contextmanager
def _guarded(bound: str) -> Iterator[None]:
    """Make servers that are started in this context, bound to this address, refuse other pages and send `HEADERS`."""
    serve: Any = websockets_server.serve
    logger = logging.getLogger("obpose.viewer.websockets")
    if not logger.filters:
        logger.addFilter(_is_no_handshake_error)

    def guarded(*arguments: Any, process_request: Any = None, **options: Any) -> Any:
        def answer(connection: Connection, request: Request) -> Any:
            if status := refusal(request, bound):
                return connection.respond(status, "Pages of other servers may not connect.\n")
            if connection.method == "OPTIONS":
                return connection.respond(HTTPStatus.NO_CONTENT, "")
            is_socket = request.headers.get("Upgrade", "").lower() == "websocket"
            if connection.method == "HEAD" and is_socket:
                return connection.respond(HTTPStatus.BAD_REQUEST, "A websocket begins with GET.\n")
            return process_request(connection, request) if process_request else None

        def finish(connection: Connection, _request: Request, response: Response) -> None:
            for name, value in HEADERS.items():
                response.headers[name] = value
            if connection.method == "OPTIONS":
                response.headers["Allow"] = _ALLOW
            if connection.method != "GET":
                response.body = b""

        hooks = {"process_request": answer, "process_response": finish, "create_connection": Connection}
        return serve(*arguments, **{**options, **hooks, "logger": logger})

    websockets_server.serve = guarded
    try:
        yield
    finally:
        websockets_server.serve = serve


def _is_no_handshake_error(record: logging.LogRecord) -> bool:
    """Filter messages about refused and malformed requests out of the log."""
    return not record.getMessage().startswith(("opening handshake failed", "connection rejected"))
