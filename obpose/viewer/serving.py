"""The server of viser, kept quiet, as it writes to the terminal whether it is told to or not, and to our own page.

A browser lets every page that it shows connect to servers of this machine, and viser asks nobody where they are from:
the server of websockets that it starts is made to.
"""

from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from http import HTTPStatus
from io import StringIO
from ipaddress import ip_address
from typing import Any
from urllib.parse import urlsplit

import viser
from websockets.asyncio import server as websockets_server

from obpose.errors import UsageError


def open_server(host: str, port: int, title: str) -> viser.ViserServer:
    """A server that listens at this port and no other.

    Raises:
        UsageError: somebody else listens there.
    """
    with redirect_stdout(StringIO()), _own_pages_only(host):
        server = viser.ViserServer(host=host, port=port, label=title, verbose=False)
    if server.get_port() != port:
        close_server(server)
        raise UsageError(f"Port {port} was taken meanwhile; give another --port.")
    return server


def close_server(server: viser.ViserServer) -> None:
    """Let go of all who look."""
    with redirect_stdout(StringIO()):
        server.stop()


def is_foreign(origin: str | None, host: str | None, bound: str) -> bool:
    """Whether a request is of a page of another server than the one it goes to; what is no browser names no origin.

    To a server that is bound to this machine alone no page has come by a name of the network: one that says so had its
    name changed to this machine's address meanwhile (DNS rebinding).
    """
    if origin is None:
        return False
    return urlsplit(origin).netloc != host or (_is_local(bound) and not _is_local(urlsplit(origin).hostname))


def _is_local(name: str | None) -> bool:
    try:
        return name == "localhost" or ip_address(name or "").is_loopback
    except ValueError:
        return False


@contextmanager
def _own_pages_only(bound: str) -> Iterator[None]:
    """Servers that are started meanwhile, bound to this address, refuse the pages of others."""
    serve: Any = websockets_server.serve

    def guarded(*arguments: Any, process_request: Any = None, **options: Any) -> Any:
        def answer(connection: Any, request: Any) -> Any:
            if is_foreign(request.headers.get("Origin"), request.headers.get("Host"), bound):
                return connection.respond(HTTPStatus.FORBIDDEN, "Pages of other servers may not connect.\n")
            return process_request(connection, request) if process_request else None

        return serve(*arguments, process_request=answer, **options)

    websockets_server.serve = guarded
    try:
        yield
    finally:
        websockets_server.serve = serve
