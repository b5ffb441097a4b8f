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

from obpose.viewer.server import HEADERS, MAX_HEAD, MAX_URL, close_server, is_foreign, open_server, refusal
from tests.obpose.viewer.driving import free_port


@pytest.fixture(scope="module")
def server() -> Iterator[viser.ViserServer]:
    found = open_server("127.0.0.1", free_port(), "a test")
    yield found
    close_server(found)


def ask(server: viser.ViserServer, method: str, url: str = "/", **headers: str) -> http.client.HTTPResponse:
    """Send a request and read the whole response."""
    connection = http.client.HTTPConnection("127.0.0.1", server.get_port(), timeout=20)
    connection.request(method, url, headers=headers)
    answer = connection.getresponse()
    answer.body = answer.read()  # pyright: ignore[reportAttributeAccessIssue]
    connection.close()
    return answer


def say(server: viser.ViserServer, *parts: bytes) -> bytes:
    """Send bytes part by part and give everything that comes back."""
    with socket.create_connection(("127.0.0.1", server.get_port()), timeout=20) as connection:
        for part in parts:
            connection.sendall(part)
        answer = b""
        while part := connection.recv(65536):
            answer += part
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
    page, head = ask(server, "GET"), ask(server, "HEAD")
    assert (page.status, head.status) == (200, 200)
    assert b"<html" in page.body.lower()  # pyright: ignore[reportAttributeAccessIssue]
    assert head.body == b""  # pyright: ignore[reportAttributeAccessIssue]
    assert head.headers["Content-Length"] == page.headers["Content-Length"]
    for answer in (page, head, ask(server, "GET", "/nowhere"), ask(server, "PUT"), ask(server, "OPTIONS")):
        assert {name: answer.headers[name] for name in HEADERS} == HEADERS


def test_options_lists_the_methods(server: viser.ViserServer):
    for url in ("/", "*"):
        answer = ask(server, "OPTIONS", url)
        assert (answer.status, answer.headers["Allow"]) == (204, "GET, HEAD, OPTIONS")


@pytest.mark.parametrize("method", ["PUT", "DELETE", "POST", "PATCH", "TRACE", "CONNECT", "get", "X"])
def test_other_methods_are_not_allowed(server: viser.ViserServer, method: str):
    answer = ask(server, method)
    assert (answer.status, answer.headers["Allow"]) == (405, "GET, HEAD, OPTIONS")


@pytest.mark.parametrize(
    "url", ["/../../../etc/passwd", "/..%2f..%2f..%2fetc/passwd", "/%2e%2e/%2e%2e/etc/passwd", "/..\\..\\etc\\passwd"]
)
def test_no_path_leads_out(server: viser.ViserServer, url: str):
    answer = ask(server, "GET", url)
    assert answer.status == 404
    assert b"root" not in answer.body  # pyright: ignore[reportAttributeAccessIssue]


HOST = b"Host: 127.0.0.1\r\n"


@pytest.mark.parametrize(
    ("parts", "status"),
    [
        ([b"garbage\r\n\r\n"], 400),
        ([b"GET /\r\n\r\n"], 400),
        ([b"GET / HTTP/1.1\r\n\r\n"], 400),
        ([b"GET / HTTP/1.0\r\n" + HOST + b"\r\n"], 505),
        ([b"GET http://elsewhere/ HTTP/1.1\r\n" + HOST + b"\r\n"], 400),
        ([b"GET / HTTP/1.1\r\nno header\r\n\r\n"], 400),
        ([b"GET / HTTP/1.1\r\n" + HOST + b"Content-Length: x\r\n\r\n"], 400),
        ([b"GET / HTTP/1.1\r\n" + HOST + b"Origin: http://[::1\r\n\r\n"], 403),
        ([b"GET / HTTP/1.1\r\nHost: evil.example\r\n\r\n"], 403),
        ([b"GET /" + b"x" * MAX_URL + b" HTTP/1.1\r\n" + HOST + b"\r\n"], 414),
        ([b"x" * (MAX_HEAD + 1)], 414),
        ([b"GET / HTTP/1.1\r\nA: " + b"x" * MAX_HEAD], 431),
        ([b"HE", b"AD / HTT", b"P/1.1\r\n" + HOST, b"\r\n"], 200),
        ([b"HEAD / HTTP/1.1\r\n" + HOST + b"Upgrade: websocket\r\n\r\n"], 400),
    ],
)
def test_malformed_requests_are_answered(server: viser.ViserServer, parts: list[bytes], status: int):
    assert say(server, *parts).startswith(b"HTTP/1.1 %d " % status)


def test_refused_requests_are_not_logged(server: viser.ViserServer, capfd: pytest.CaptureFixture[str]):
    say(server, b"garbage\r\n\r\n")
    ask(server, "GET", "/nowhere")
    ask(server, "GET", Origin="http://[::1")
    with socket.create_connection(("127.0.0.1", server.get_port())) as connection:
        connection.sendall(b"GET /")
    assert capfd.readouterr() == ("", "")
