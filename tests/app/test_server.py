"""The server answers pages of its own, on this machine, and nobody else."""

import pytest
from tornado import httputil, web

from mcspectra.app.server import ADDRESS, Guard, make_server
from mcspectra.cli.main import main
from mcspectra.core.errors import ParameterError

PORT = 5006


def answers(*headers):
    """Whether a request with these headers reaches the application."""

    class Page(web.RequestHandler):
        """The page of the test."""

    given = httputil.HTTPHeaders()
    for name, value in headers:
        given.add(name, value)
    start = httputil.RequestStartLine("GET", "/", "HTTP/1.1")
    request = httputil.HTTPServerRequest(headers=given, start_line=start)
    delegate = Guard(web.Application([("/", Page)]), PORT).find_handler(request)
    return delegate.handler_class is Page


OWN = ("Host", f"127.0.0.1:{PORT}")


@pytest.mark.parametrize(
    "headers",
    [
        [OWN],
        [("Host", f"localhost:{PORT}")],
        [("Host", f"LOCALHOST:{PORT}")],
        [OWN, ("Origin", f"http://127.0.0.1:{PORT}")],
        [OWN, ("Origin", f"http://localhost:{PORT}")],
    ],
)
def test_own_pages_are_answered(headers):
    assert answers(*headers)


@pytest.mark.parametrize(
    "headers",
    [
        [("Host", "")],
        [("Host", "127.0.0.1")],
        [("Host", f"evil.example:{PORT}")],
        [("Host", f"127.0.0.1.evil.example:{PORT}")],
        [("Host", f"127.0.0.1:{PORT + 1}")],
        [OWN, ("Origin", "http://evil.example")],
        [OWN, ("Origin", "null")],
        [OWN, ("Origin", "")],
        [OWN, ("Origin", f"https://127.0.0.1:{PORT}")],
        [OWN, ("Origin", f"http://127.0.0.1:{PORT + 1}")],
        [OWN, ("Origin", f"http://127.0.0.1:{PORT}"), ("Origin", "http://evil.example")],
    ],
)
def test_others_are_refused(headers):
    assert not answers(*headers)


@pytest.mark.parametrize("port", [-1, 65536, 1.5, "x", None])
def test_ports_out_of_range_are_refused(port):
    with pytest.raises(ParameterError, match="port"):
        make_server(port)


@pytest.mark.parametrize(
    "options", [["--port", "x"], ["--port", "70000"], ["--json"], ["--seed", "1"]]
)
def test_bad_options_are_a_sentence(options, capsys):
    assert main(["app", *options]) == 2
    said = capsys.readouterr().err
    assert said.startswith("mcspectra: ")
    assert "Traceback" not in said
    assert ADDRESS not in said
