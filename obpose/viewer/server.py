"""The viser server, restricted to requests of its own page.

Browsers let every open page connect to servers of this machine, and viser does not check the origin of requests. Hooks
of its websocket server, which also serves the page, do.
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

from obpose.errors import UsageError

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
    """Start a server at exactly this port.

    Raises:
        UsageError: another process uses the port.
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


@contextmanager
def _guarded(bound: str) -> Iterator[None]:
    """Make servers that are started in this context, bound to this address, refuse other pages and send `HEADERS`."""
    serve: Any = websockets_server.serve
    logger = logging.getLogger("obpose.viewer.websockets")
    if not logger.filters:
        logger.addFilter(_is_no_handshake_error)

    def guarded(*arguments: Any, process_request: Any = None, **options: Any) -> Any:
        def answer(connection: ServerConnection, request: Request) -> Any:
            if status := refusal(request, bound):
                return connection.respond(status, "Pages of other servers may not connect.\n")
            return process_request(connection, request) if process_request else None

        def finish(_connection: ServerConnection, _request: Request, response: Response) -> None:
            for name, value in HEADERS.items():
                response.headers[name] = value

        hooks = {"process_request": answer, "process_response": finish}
        return serve(*arguments, **{**options, **hooks, "logger": logger})

    websockets_server.serve = guarded
    try:
        yield
    finally:
        websockets_server.serve = serve


def _is_no_handshake_error(record: logging.LogRecord) -> bool:
    """Filter messages about refused and malformed requests out of the log."""
    return not record.getMessage().startswith(("opening handshake failed", "connection rejected"))
