"""The server of viser, kept quiet, answering HTTP as browsers and scanners expect, and only to our own page.

A browser lets every page that it shows connect to servers of this machine, and viser does not check where requests come
from. Its server of websockets, which also serves the page, drops requests that it cannot parse without an answer. Both
are mended here, in a class of connections and in hooks of the server.
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

MOST_URL = 2048
"""Longest URL, characters."""
MOST_HEAD = 32_768
"""Largest head of a request, bytes."""
_METHODS = {"GET", "HEAD", "OPTIONS"}
_ALLOW = "GET, HEAD, OPTIONS"

HEADERS = {
    "X-Frame-Options": "DENY",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    # viser's page is one file that unpacks itself: an inline script, workers from blobs, and WebAssembly whose bindings
    # are evaluated from strings. What remains forbidden is everything from, and to, other servers.
    "Content-Security-Policy": "; ".join(
        [
            "default-src 'none'",
            "script-src 'self' 'unsafe-inline' 'unsafe-eval' blob:",
            "style-src 'self' 'unsafe-inline'",
            "img-src 'self' data: blob:",
            "font-src 'self' data:",
            "connect-src 'self' data: blob:",
            "worker-src 'self' blob:",
            "base-uri 'none'",
            "form-action 'none'",
            "frame-ancestors 'none'",
        ]
    ),
}
"""Sent with every answer."""


def open_server(host: str, port: int, title: str) -> viser.ViserServer:
    """Start a server that listens at this port and no other.

    Raises:
        UsageError: another process listens there.
    """
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
    """Say with which status a request must be refused, None if it may be answered.

    Requests of pages of other servers are refused. Programs other than browsers name no origin. A server that is bound
    to this machine alone expects its address as the host: another name was changed to this machine's address meanwhile
    (DNS rebinding).
    """
    origins, hosts = (request.headers.get_all(name) for name in ("Origin", "Host"))
    if len(hosts) != 1 or len(origins) > 1 or not _name_of(hosts[0]):
        return HTTPStatus.BAD_REQUEST
    if _is_local(bound) and not _is_local(_name_of(hosts[0])):
        return HTTPStatus.FORBIDDEN
    if origins and is_foreign(origins[0], hosts[0], bound):
        return HTTPStatus.FORBIDDEN
    return None


def is_foreign(origin: str | None, host: str | None, bound: str) -> bool:
    """Whether a request is of a page of another server than the one it goes to; a malformed origin is foreign."""
    if origin is None:
        return False
    try:
        parts = urlsplit(origin)
        return parts.netloc != host or (_is_local(bound) and not _is_local(parts.hostname))
    except ValueError:
        return True


def _name_of(host: str) -> str | None:
    """The name or address in `name:port`, None where it is malformed."""
    try:
        parts = urlsplit(f"//{host}")
        # Also raises where the port is no number.
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
    """A connection that answers what `websockets` drops: methods other than GET, and malformed requests."""

    method = "GET"
    _head = b""
    _begun = False

    def data_received(self, data: bytes) -> None:
        """Look at the head of the request before the library does."""
        if self._begun:
            super().data_received(data)
            return
        self._head += data
        if b"\r\n\r\n" not in self._head and len(self._head) <= MOST_HEAD:
            return
        self._begun = True
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
    """Give the method of a request, and the status to refuse it with if the library could not parse it."""
    line, _, rest = head.partition(b"\r\n")
    parts = line.decode("latin-1").split(" ")
    if len(parts) != 3 or not parts[2].startswith("HTTP/"):
        return "", HTTPStatus.REQUEST_URI_TOO_LONG if len(line) > MOST_URL else HTTPStatus.BAD_REQUEST
    method, url, version = parts
    if len(url) > MOST_URL:
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
    except Exception:  # whatever the library raises means that it would drop the request
        pass
    return method, HTTPStatus.BAD_REQUEST


@contextmanager
def _guarded(bound: str) -> Iterator[None]:
    """Let servers that are started meanwhile, bound to this address, refuse the pages of others and send `HEADERS`."""
    serve: Any = websockets_server.serve
    logger = logging.getLogger("obpose.viewer.websockets")
    if not logger.filters:
        logger.addFilter(_is_no_handshake)

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


def _is_no_handshake(record: logging.LogRecord) -> bool:
    """Keep requests that were refused or malformed out of the terminal."""
    return not record.getMessage().startswith(("opening handshake failed", "connection rejected"))
