import http.client
import socket
from collections.abc import Iterator
from http import HTTPStatus

import pytest
import viser
from websockets.datastructures import Headers
from websockets.exceptions import InvalidStatus
from websockets.http11 import Request
from websockets.sync.client import connect

from obpose.viewer.server import HEADERS, close_server, is_foreign, open_server, refusal
from tests.obpose.viewer.driving import free_port


@pytest.fixture(scope="module")
def server() -> Iterator[viser.ViserServer]:
    found = open_server("127.0.0.1", free_port(), "a test")
    yield found
    close_server(found)


def ask(server: viser.ViserServer, url: str, **headers: str) -> http.client.HTTPResponse:
    """Send a request and read the whole response."""
    connection = http.client.HTTPConnection("127.0.0.1", server.get_port(), timeout=20)
    connection.request("GET", url, headers=headers)
    answer = connection.getresponse()
    answer.body = answer.read()  # pyright: ignore[reportAttributeAccessIssue]
    connection.close()
    return answer


def test_pages_of_other_servers_may_not_connect(server: viser.ViserServer):
    place = f"127.0.0.1:{server.get_port()}"
    for origin in ("https://elsewhere.example", "http://127.0.0.1:1", "null", "http://[::1", "http://[", "//", "x"):
        with pytest.raises(InvalidStatus) as refused:
            connect(f"ws://{place}", origin=origin)
        assert refused.value.response.status_code == HTTPStatus.FORBIDDEN
    for origin in (f"http://{place}", None):
        connect(f"ws://{place}", origin=origin).close()


@pytest.mark.parametrize(
    ("origin", "host", "foreign"),
    [
        ("http://127.0.0.1:8080", "127.0.0.1:8080", False),
        ("http://[::1]:8080", "[::1]:8080", False),
        ("http://localhost:8080", "localhost:8080", False),
        ("http://localhost:8080", "127.0.0.1:8080", True),
        ("http://127.0.0.1:8081", "127.0.0.1:8080", True),
        ("null", "127.0.0.1:8080", True),
        ("", "127.0.0.1:8080", True),
        ("http://evil.example:8080", "evil.example:8080", True),
        ("http://8.8.8.8:8080", "8.8.8.8:8080", True),
        ("http://[::1", "127.0.0.1:8080", True),
        ("http://[x]:8080", "[x]:8080", True),
    ],
)
def test_an_origin_is_foreign_unless_it_is_the_server_itself(origin: str, host: str, foreign: bool):
    assert is_foreign(origin, host, "127.0.0.1") is foreign


def test_a_public_server_has_names_of_the_network():
    assert not is_foreign("https://machine", "machine", "0.0.0.0")
    assert is_foreign("https://elsewhere.example", "machine", "0.0.0.0")


@pytest.mark.parametrize(
    ("headers", "bound", "status"),
    [
        ([("Host", "127.0.0.1:80")], "127.0.0.1", None),
        ([("Host", "localhost")], "127.0.0.1", None),
        ([("Host", "[::1]:80")], "::1", None),
        ([("Host", "machine:80")], "0.0.0.0", None),
        ([("Host", "evil.example:80")], "127.0.0.1", HTTPStatus.FORBIDDEN),
        ([("Host", "127.0.0.1.evil.example")], "localhost", HTTPStatus.FORBIDDEN),
        ([], "127.0.0.1", HTTPStatus.BAD_REQUEST),
        ([("Host", "")], "0.0.0.0", HTTPStatus.BAD_REQUEST),
        ([("Host", "[::1")], "0.0.0.0", HTTPStatus.BAD_REQUEST),
        ([("Host", "a:x")], "0.0.0.0", HTTPStatus.BAD_REQUEST),
        ([("Host", "a:99999")], "0.0.0.0", HTTPStatus.BAD_REQUEST),
        ([("Host", "a@b")], "0.0.0.0", HTTPStatus.BAD_REQUEST),
        ([("Host", "a/b")], "0.0.0.0", HTTPStatus.BAD_REQUEST),
        ([("Host", "127.0.0.1"), ("Host", "evil.example")], "127.0.0.1", HTTPStatus.BAD_REQUEST),
        ([("Host", "127.0.0.1"), ("Origin", "http://127.0.0.1"), ("Origin", "x")], "127.0.0.1", HTTPStatus.BAD_REQUEST),
    ],
)
def test_requests_need_one_host_which_is_local_for_a_local_server(
    headers: list[tuple[str, str]], bound: str, status: HTTPStatus | None
):
    found = Headers()
    for name, value in headers:
        found[name] = value
    assert refusal(Request("/", found), bound) == status


def test_every_response_has_the_security_headers(server: viser.ViserServer):
    page = ask(server, "/")
    assert page.status == 200
    assert b"<html" in page.body.lower()  # pyright: ignore[reportAttributeAccessIssue]
    for answer in (page, ask(server, "/nowhere"), ask(server, "/", Origin="http://[::1")):
        assert {name: answer.headers[name] for name in HEADERS} == HEADERS


@pytest.mark.parametrize(
    "url", ["/../../../etc/passwd", "/..%2f..%2f..%2fetc/passwd", "/%2e%2e/%2e%2e/etc/passwd", "/..\\..\\etc\\passwd"]
)
def test_no_path_leads_out(server: viser.ViserServer, url: str):
    answer = ask(server, url)
    assert answer.status == 404
    assert b"root" not in answer.body  # pyright: ignore[reportAttributeAccessIssue]


def test_refused_requests_are_not_logged(server: viser.ViserServer, capfd: pytest.CaptureFixture[str]):
    for part in (b"garbage\r\n\r\n", b"HEAD / HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n", b"GET /"):
        with socket.create_connection(("127.0.0.1", server.get_port()), timeout=20) as connection:
            connection.sendall(part)
            connection.shutdown(socket.SHUT_WR)
            assert connection.recv(65536) == b""
    assert ask(server, "/nowhere").status == 404
    assert ask(server, "/", Origin="http://[::1").status == 403
    assert capfd.readouterr() == ("", "")
