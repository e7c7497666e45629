"""The server of the explorer. It answers only requests from this machine and from its own pages.

The server listens on the loopback interface, which excludes other machines.
Pages from other hosts, open in the user's browser, may still send requests to this server.
The owner of such a page may also let its domain name point to 127.0.0.1.
Every request must therefore name this server as its Host, and as its Origin if it has any.
The only request from another site that is accepted is a link to the page.
No other page may embed this page in a frame.

The number of open pages is limited. `mcspectra.app.compute` also limits their computations.
"""

from __future__ import annotations

import logging
import socket
import threading
import traceback
import warnings
import weakref
from collections.abc import Awaitable, Callable
from functools import partial
from typing import TYPE_CHECKING, Any, final
from urllib.parse import urlsplit

from tornado import httputil, routing, web

from mcspectra.core.checks import as_integer
from mcspectra.core.display import printable
from mcspectra.core.errors import ParameterError

if TYPE_CHECKING:
    from mcspectra.app.page import FirstPage

__all__ = ["ADDRESS", "MOST_SESSIONS", "Guard", "make_server", "serve"]

ADDRESS = "127.0.0.1"
"""Address at which the server listens."""

MOST_SESSIONS = 32
"""Maximum number of open pages. Each page holds 50 MB of figures, and takes 0.2 s to create."""

_HEADERS = {
    "Content-Security-Policy": "frame-ancestors 'none'",
    "X-Frame-Options": "DENY",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "X-Content-Type-Options": "nosniff",
}
_MOST_SENT = 64 * 2**20  # maximum size of a message in bytes; pictures arrive as text


@final
class Guard(routing.Router):
    """Forwards requests by the server's own pages to an application. Others are answered with 403.

    Parameters
    ----------
    application
        Application that answers requests by the server's own pages.
    port
        Port of the server.
    sessions
        Function that returns the number of open pages.
    """

    def __init__(
        self, application: web.Application, port: int, sessions: Callable[[], int] = lambda: 0
    ) -> None:
        self._application = application
        self._sessions = sessions
        self._hosts = {f"{name}:{port}" for name in (ADDRESS, "localhost")}
        self._origins = {f"http://{host}" for host in self._hosts}
        # Requests for a page that is not open yet; they are removed when their connection closes
        self._awaited: weakref.WeakSet[httputil.HTTPServerRequest] = weakref.WeakSet()
        application.add_transform(_Headers)
        # Called at the end of each request; by default, tornado would print a log line
        application.settings["log_function"] = self._ended
        others: dict[str, Any] = {"transforms": [_Headers], "log_function": self._ended}
        self._refusal = web.Application([(".*", _Refusal)], **others)
        self._busy = web.Application([(".*", _Busy)], **others)

    def find_handler(
        self, request: httputil.HTTPServerRequest, **kwargs: Any
    ) -> httputil.HTTPMessageDelegate | None:
        """Return the handler for a request."""
        if not self._is_trusted(request):
            chosen = self._refusal
        elif request.path == "/" and self._sessions() + len(self._awaited) >= MOST_SESSIONS:
            chosen = self._busy
        else:
            chosen = self._application
            if request.path == "/":
                self._awaited.add(request)
        return chosen.find_handler(request, **kwargs)

    def _ended(self, handler: web.RequestHandler) -> None:
        self._awaited.discard(handler.request)

    def _is_trusted(self, request: httputil.HTTPServerRequest) -> bool:
        """Whether a request comes from this server's page, the user, or a link to the page."""
        headers = request.headers
        hosts, origins = headers.get_list("Host"), headers.get_list("Origin")
        if len(hosts) != 1 or hosts[0].lower() not in self._hosts:
            return False
        if not all(each.lower() in self._origins for each in origins):
            return False
        # Allow only the paths of the page, because other paths of Bokeh also open sessions.
        # Bokeh's pattern for the path of autoload.js also matches other names
        if request.path not in ("/", "/ws") and not request.path.startswith("/static/"):
            return False
        is_page = request.path == "/" and request.method in ("GET", "HEAD")
        sites = headers.get_list("Sec-Fetch-Site")
        if sites:
            link = (headers.get("Sec-Fetch-Mode"), headers.get("Sec-Fetch-Dest"))
            linked = is_page and link == ("navigate", "document")
            return linked or all(site in ("same-origin", "none") for site in sites)
        # Browsers before 2023 do not send Sec-Fetch-Site, but they send a Referer
        referers = map(urlsplit, headers.get_list("Referer"))
        return is_page or all(f"{r.scheme}://{r.netloc}".lower() in self._origins for r in referers)


class _Headers(web.OutputTransform):
    """Headers of every answer: no frame may contain the page, and no other site may read it."""

    def transform_first_chunk(
        self, status_code: int, headers: httputil.HTTPHeaders, chunk: bytes, finishing: bool
    ) -> tuple[int, httputil.HTTPHeaders, bytes]:
        """Add the headers, and remove the header by which bokeh permits all sites."""
        del finishing
        for name in [name for name in headers if name.startswith("Access-Control-")]:
            del headers[name]
        headers.update(_HEADERS)
        return status_code, headers, chunk


class _Refusal(web.RequestHandler):
    """Answers every request with 403 and a sentence."""

    def prepare(self) -> Awaitable[None] | None:
        """Answer with the error 403 before a method for GET, POST and so on is called."""
        self.set_status(403)
        self.set_header("Content-Type", "text/plain; charset=utf-8")
        self.finish("The explorer answers only its own pages; open the address that it printed.\n")
        return None


class _Busy(web.RequestHandler):
    """Answers with 503 and a sentence, because too many pages are open."""

    def prepare(self) -> Awaitable[None] | None:
        """Send the answer before the method for GET, POST and so on is called."""
        self.set_status(503)
        self.set_header("Content-Type", "text/plain; charset=utf-8")
        self.finish(
            f"{MOST_SESSIONS} pages of the explorer are open, which is the limit; close some and "
            "reload this one in half a minute.\n"
        )
        return None


def make_server(port: int = 0, first: FirstPage | None = None) -> Any:
    """Return a `bokeh.server.server.Server` that is bound to its port but not started.

    Parameters
    ----------
    port
        Port on the loopback interface. 0 stands for any free port.
    first
        The default page if it is made in advance.

    Raises
    ------
    ParameterError
        If the port is out of range or taken.
    """
    from bokeh.server.server import Server
    from bokeh.settings import settings

    from mcspectra.app.page import build_page

    # Bokeh would search each new page for mistakes, and warn of layouts that are still empty
    settings.perform_document_validation.set_value(False)
    if as_integer("port", port, least=0, most=65535) == 0:
        with socket.socket() as probe:
            probe.bind((ADDRESS, 0))
            port = int(probe.getsockname()[1])
    try:
        server: Any = Server(
            {"/": partial(build_page, first=first)},
            port=port,
            address=ADDRESS,
            allow_websocket_origin=[f"{ADDRESS}:{port}", f"localhost:{port}"],
            http_server_kwargs={"max_buffer_size": _MOST_SENT},
            websocket_max_message_size=_MOST_SENT,
        )
    except OSError as error:
        reason = error.strerror or "it is taken"
        raise ParameterError(f"Port {port} cannot be used: {reason}; give another port.") from None
    server._http.request_callback = Guard(
        server._tornado, port, lambda: len(server.get_sessions("/"))
    )
    return server


def serve(port: int = 0, *, open_browser: bool = True, quiet: bool = False) -> None:
    """Run the explorer until it is interrupted.

    Parameters
    ----------
    port
        Port of the server, same as in `make_server`.
    open_browser
        Whether to open the page in a browser.
    quiet
        Whether to suppress the message with the address.

    Raises
    ------
    ParameterError
        If the port cannot be used.
    """
    import webbrowser

    from mcspectra.app.page import FirstPage

    first = FirstPage()
    server = make_server(port, first)
    # The page itself shows warnings, so do not repeat them on standard error.
    warnings.simplefilter("ignore")
    # If a tab closes early, bokeh logs a warning and assertions fail: ignore them
    logging.getLogger("bokeh.server.views.ws").setLevel(logging.ERROR)
    logging.getLogger("bokeh.server.protocol_handler").addFilter(_has_open_tab)
    logging.getLogger("tornado.application").addFilter(_is_own_error)
    address = f"http://{ADDRESS}:{server.port}/"
    if not quiet:
        print(f"The explorer is at {address}; stop it with Ctrl-C.", flush=True)
    server.start()
    # Load and compile code while the browser starts and loads the first page
    threading.Thread(target=first.make, name="explorer warm-up", daemon=True).start()
    if open_browser:
        server.io_loop.add_callback(webbrowser.open, address)
    server.io_loop.start()


def _is_own_error(record: logging.LogRecord) -> bool:
    """Make the text of a logged error printable.

    Return True if the explorer itself caused the error, and False if a request caused it.
    """
    text = record.getMessage()
    record.msg, record.args = printable(text, lines=True), ()
    return "GET /ws" not in text and "GET /static" not in text


def _has_open_tab(record: logging.LogRecord) -> bool:
    """Return False if a message failed only because its tab had closed before.

    Bokeh's ``ServerConnection.session`` asserts that the tab is still connected.
    """
    error = record.exc_info[1] if record.exc_info else None
    if not isinstance(error, AssertionError):
        return True
    return traceback.extract_tb(error.__traceback__)[-1].name != "session"
