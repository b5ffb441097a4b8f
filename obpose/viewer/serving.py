"""The server of viser, which writes to the terminal whether it is told to or not, kept quiet."""

from contextlib import redirect_stdout
from io import StringIO

import viser

from obpose.errors import UsageError


def open_server(host: str, port: int, title: str) -> viser.ViserServer:
    """A server that listens at this port and no other.

    Raises:
        UsageError: somebody else listens there.
    """
    with redirect_stdout(StringIO()):
        server = viser.ViserServer(host=host, port=port, label=title, verbose=False)
    if server.get_port() != port:
        close_server(server)
        raise UsageError(f"Port {port} was taken meanwhile; give another --port.")
    return server


def close_server(server: viser.ViserServer) -> None:
    """Let go of all who look."""
    with redirect_stdout(StringIO()):
        server.stop()
