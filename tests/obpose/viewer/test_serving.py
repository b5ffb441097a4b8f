from collections.abc import Iterator

import pytest
import viser
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from obpose.viewer.serving import close_server, is_foreign, open_server
from tests.obpose.viewer.test_page import free_port


@pytest.fixture
def server() -> Iterator[viser.ViserServer]:
    found = open_server("127.0.0.1", free_port(), "a test")
    yield found
    close_server(found)


def test_pages_of_other_servers_may_not_connect(server: viser.ViserServer):
    place = f"127.0.0.1:{server.get_port()}"
    for origin in ("https://elsewhere.example", "http://127.0.0.1:1", "null"):
        with pytest.raises(InvalidStatus) as refused:
            connect(f"ws://{place}", origin=origin)
        assert refused.value.response.status_code == 403
    for origin in (f"http://{place}", None):
        connect(f"ws://{place}", origin=origin).close()


@pytest.mark.parametrize(
    ("origin", "host", "foreign"),
    [
        (None, "127.0.0.1:8080", False),
        ("http://127.0.0.1:8080", "127.0.0.1:8080", False),
        ("http://[::1]:8080", "[::1]:8080", False),
        ("http://localhost:8080", "localhost:8080", False),
        ("http://localhost:8080", "127.0.0.1:8080", True),
        ("http://127.0.0.1:8081", "127.0.0.1:8080", True),
        ("null", "127.0.0.1:8080", True),
        ("", None, True),
        ("http://evil.example:8080", "evil.example:8080", True),
        ("http://8.8.8.8:8080", "8.8.8.8:8080", True),
    ],
)
def test_a_page_is_of_the_server_that_it_names(origin: str | None, host: str | None, foreign: bool):
    assert is_foreign(origin, host, "127.0.0.1") is foreign


def test_a_server_for_others_goes_by_names_of_the_network():
    assert not is_foreign("https://machine", "machine", "0.0.0.0")
    assert is_foreign("https://elsewhere.example", "machine", "0.0.0.0")
