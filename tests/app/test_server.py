"""The server answers only its own pages on this machine."""

import asyncio
import contextlib
import http.client
import logging
import re
import socket
import threading
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from unittest.mock import Mock

import pytest
from bokeh.server.connection import ServerConnection
from bokeh.server.protocol_handler import ProtocolHandler
from tornado import httputil, web

from mcspectra.app import compute, server
from mcspectra.app.page import FirstPage
from mcspectra.app.server import ADDRESS, Guard, make_server
from mcspectra.cli.main import main
from mcspectra.core.errors import ParameterError

PORT = 5006


def answers(*headers, path="/", method="GET"):
    """Whether a request with these headers reaches the application."""

    class Page(web.RequestHandler):
        """The page of the test."""

    given = httputil.HTTPHeaders()
    for name, value in headers:
        given.add(name, value)
    start = httputil.RequestStartLine(method, path, "HTTP/1.1")
    request = httputil.HTTPServerRequest(headers=given, start_line=start)
    delegate = Guard(web.Application([(".*", Page)]), PORT).find_handler(request)
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
def test_foreign_requests_are_refused(headers):
    assert not answers(*headers)


def fetch(site, mode="no-cors", dest="script"):
    return [OWN, ("Sec-Fetch-Site", site), ("Sec-Fetch-Mode", mode), ("Sec-Fetch-Dest", dest)]


LINK = ("navigate", "document")


@pytest.mark.parametrize(
    ("path", "headers"),
    [
        ("/", fetch("none", *LINK)),
        ("/", fetch("cross-site", *LINK)),
        ("/", fetch("same-site", *LINK)),
        ("/?n=64", fetch("cross-site", *LINK)),
        ("/static/js/bokeh.min.js", fetch("same-origin")),
        ("/ws", fetch("same-origin", "websocket", "empty")),
        ("/static/js/bokeh.min.js", [OWN, ("Referer", f"http://127.0.0.1:{PORT}/?n=4")]),
        ("/", [OWN, ("Referer", "http://evil.example/")]),
    ],
)
def test_links_and_own_requests_are_answered(path, headers):
    assert answers(*headers, path=path)


@pytest.mark.parametrize(
    ("path", "headers"),
    [
        ("/", fetch("cross-site")),
        ("/", fetch("cross-site", "navigate", "iframe")),
        ("/", fetch("cross-site", "navigate", "embed")),
        ("/", fetch("same-site", "cors", "empty")),
        ("/", [OWN, ("Sec-Fetch-Site", "cross-site")]),
        ("/", [OWN, ("Sec-Fetch-Site", "same-origin"), ("Sec-Fetch-Site", "cross-site")]),
        ("/ws", fetch("cross-site", *LINK)),
        ("/static/js/bokeh.min.js", fetch("cross-site")),
        ("/autoload.js", fetch("cross-site")),
        ("/autoload.js?bokeh-autoload-element=1", [OWN]),
        ("/static/js/bokeh.min.js", [OWN, ("Referer", "http://evil.example/")]),
        ("/metadata", [OWN, ("Referer", f"http://127.0.0.1:{PORT + 1}/")]),
    ],
)
def test_other_sites_without_origin_are_refused(path, headers):
    """Such sites used to get a session and its token."""
    assert not answers(*headers, path=path)


@pytest.mark.parametrize(
    "path",
    [
        *("/autoload.js", "/autoload_js", "/autoload%js?bokeh-autoload-element=1", "/metadata"),
        *("//", "", "?n=4", "/static", "/ws/", "/index.html"),
    ],
)
def test_paths_of_bokeh_that_the_page_does_not_use_are_refused(path):
    """The pattern ``/autoload.js`` matches any character, and an empty path opened a session."""
    assert not answers(OWN, path=path)


def test_another_site_posts_nothing():
    assert not answers(*fetch("cross-site", *LINK), method="POST")


@contextlib.contextmanager
def running(made, first=None):
    """Port of a server that runs in a thread. The list `made` gets the server."""

    def serve():
        asyncio.set_event_loop(asyncio.new_event_loop())
        made.append(make_server(first=first))
        made[0].start()
        made[0].io_loop.start()

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    while not made or made[0].port is None:
        time.sleep(0.05)
    yield made[0].port
    made[0].io_loop.add_callback(made[0].stop)
    made[0].io_loop.add_callback(made[0].io_loop.stop)
    thread.join(10)


@pytest.fixture(scope="module")
def port():
    """Port of a server shared by all tests."""
    with running([]) as found:
        yield found


@pytest.fixture
def empty_port():
    """Port of a server without a page."""
    with running([]) as found:
        yield found


def get(port, path="/", **headers):
    """Return status, headers and text of an answer."""
    given = {name.replace("_", "-"): value for name, value in headers.items()}
    connection = http.client.HTTPConnection(ADDRESS, port, timeout=60)
    connection.request("GET", path, headers=given)
    answer = connection.getresponse()
    text = answer.read().decode()
    connection.close()
    return answer.status, answer.headers, text


def test_no_page_may_embed_this_one(port):
    for path, code in (
        ("/", 200),
        ("/static/js/bokeh.min.js", 200),
        ("/autoload.js", 403),
        ("/autoload_js?bokeh-autoload-element=1", 403),
    ):
        status, headers, text = get(port, path)
        assert status == code
        assert headers["Content-Security-Policy"] == "frame-ancestors 'none'"
        assert headers["X-Frame-Options"] == "DENY"
        assert not [name for name in headers if name.startswith("Access-Control-")]
        assert ('"token":' in text) == (path == "/")
    assert '"token":' not in get(port, Sec_Fetch_Site="cross-site")[2]


def test_a_request_alone_computes_nothing(port, monkeypatch):
    computed = []
    monkeypatch.setattr(compute, "compute", lambda *given: computed.append(given))
    assert get(port)[0] == 200
    time.sleep(0.5)
    assert computed == []


def test_the_first_document_has_the_top_figure_for_each_browser():
    """The second page is not the one that was made in advance, and shares no model with it."""
    made, first = [], FirstPage()
    first.take("n=16")  # the rest of the first round is not needed
    first.make()
    with running(made, first) as port:
        texts = [get(port)[2] for _ in range(2)]
        documents = [each.document for each in made[0].get_sessions("/")]
    assert len(documents) == 2
    for document in documents:
        slot = document.get_model_by_name("A and B: convergence")
        assert slot.visible
        assert len(slot.children) == 1
    owned = [{model.id for model in document.models} for document in documents]
    assert owned[0].isdisjoint(owned[1])
    for text in texts:  # the browser shows the head of the page before it runs the scripts
        scripts = re.findall(r"<script[^>]*src=[^>]*>", text)
        assert len(scripts) == 2
        assert all(each.startswith("<script defer ") for each in scripts)
        assert "Bokeh." not in text[: text.index("<body>")]  # would run before these scripts


def test_too_many_pages_give_a_sentence(port, monkeypatch):
    monkeypatch.setattr(server, "MOST_SESSIONS", 1)
    get(port)
    status, _, text = get(port)
    assert status == 503
    assert text == (
        "1 pages of the explorer are open, which is the limit; close some and reload this one in "
        "half a minute.\n"
    )
    assert get(port, "/static/js/bokeh.min.js")[0] == 200


def test_simultaneous_requests_count_as_pages(empty_port, monkeypatch):
    """Fifty simultaneous requests used to be accepted before the first page was open."""
    monkeypatch.setattr(server, "MOST_SESSIONS", 3)
    with ThreadPoolExecutor(12) as pool:
        codes = Counter(status for status, *_ in pool.map(lambda _: get(empty_port), range(12)))
    # A page that has just opened may count twice for a moment
    assert 1 <= codes[200] <= 3
    assert codes[200] + codes[503] == 12


def test_closed_connections_do_not_count_as_pages(empty_port, monkeypatch):
    monkeypatch.setattr(server, "MOST_SESSIONS", 1)
    with socket.create_connection((ADDRESS, empty_port)) as client:
        client.sendall(
            f"GET / HTTP/1.1\r\nHost: {ADDRESS}:{empty_port}\r\nContent-Length: 9\r\n\r\n".encode()
        )
        time.sleep(0.2)
        assert get(empty_port)[0] == 503
    for _ in range(50):
        time.sleep(0.1)
        if get(empty_port)[0] == 200:
            return
    pytest.fail("the place of a closed connection is still taken")


def test_requests_write_nothing_on_the_terminal(port, caplog):
    """A local program could print terminal controls, or a traceback, by requesting a page."""
    own = logging.getLogger("tornado.application")
    own.addFilter(server._is_own_error)
    try:
        for path in ("/\u009b2J", "/static/%00", "/none"):
            with socket.create_connection((ADDRESS, port), timeout=30) as client:
                head = f"GET {path} HTTP/1.1\r\nHost: {ADDRESS}:{port}\r\nConnection: close\r\n\r\n"
                client.sendall(head.encode())
                answer = client.recv(100)
                assert any(code in answer for code in (b" 403 ", b" 404 ", b" 500 "))
        assert caplog.text == ""
        own.error("Uncaught exception %s", "GET /\x9b2J")
        assert "exception GET /\\x9b2J" in caplog.text
    finally:
        own.removeFilter(server._is_own_error)


def test_messages_of_closed_tabs_write_nothing_on_the_terminal(caplog):
    """A message can arrive after its tab has closed; bokeh logs a traceback then."""
    connection = ServerConnection(Mock(), Mock(), Mock(), Mock())
    connection.detach_session()
    message = Mock(msgtype="PATCH-DOC", header={"msgid": "1"})
    own = logging.getLogger("bokeh.server.protocol_handler")
    own.addFilter(server._has_open_tab)
    try:
        # ``asyncio.run`` would drop the loop of this thread, which earlier pages have opened.
        with contextlib.closing(asyncio.new_event_loop()) as loop:
            loop.run_until_complete(ProtocolHandler().handle(message, connection))
        assert caplog.text == ""
        own.error("a failure", exc_info=ValueError("no"))
        assert "a failure" in caplog.text
    finally:
        own.removeFilter(server._has_open_tab)


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
