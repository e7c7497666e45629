"""The explorer's server: this machine only, and only for pages that it served itself.

It listens on the loopback interface. That keeps other machines out, but not pages of other hosts in
the user's own browser: these may send requests here, or point a name of theirs to 127.0.0.1. So
every request must name this server as its Host, and as its Origin where it has one.
"""

from __future__ import annotations

import logging
import socket
import threading
import warnings
from collections.abc import Awaitable
from typing import Any, final

from tornado import httputil, routing, web

from mcspectra.core.checks import as_integer
from mcspectra.core.errors import ParameterError

__all__ = ["ADDRESS", "Guard", "make_server", "serve"]

ADDRESS = "127.0.0.1"
"""Where the server listens."""

_MOST_SENT = 64 * 2**20  # bytes: pictures come in as text


@final
class Guard(routing.Router):
    """Hands requests on to an application if they are from its own pages, else answers 403.

    Parameters
    ----------
    application
        What answers.
    port
        Port of the server.
    """

    def __init__(self, application: web.Application, port: int) -> None:
        self._application = application
        self._hosts = {f"{name}:{port}" for name in (ADDRESS, "localhost")}
        self._refusal = web.Application([(".*", _Refusal)])

    def find_handler(
        self, request: httputil.HTTPServerRequest, **kwargs: Any
    ) -> httputil.HTTPMessageDelegate | None:
        """Return who answers `request`."""
        allowed = {f"http://{host}" for host in self._hosts}
        trusted = request.headers.get("Host", "").lower() in self._hosts and all(
            each.lower() in allowed for each in request.headers.get_list("Origin")
        )
        chosen = self._application if trusted else self._refusal
        return chosen.find_handler(request, **kwargs)


class _Refusal(web.RequestHandler):
    """403 with a sentence, whatever is asked."""

    def prepare(self) -> Awaitable[None] | None:
        """Answer before any method is looked at."""
        self.set_status(403)
        self.set_header("Content-Type", "text/plain; charset=utf-8")
        self.finish("The explorer answers its own pages only; open the address that it printed.\n")
        return None


def make_server(port: int = 0) -> Any:
    """Return a server that is bound but not started, `bokeh.server.server.Server`.

    Parameters
    ----------
    port
        Port on the loopback interface; 0 for any free one.

    Raises
    ------
    ParameterError
        The port is out of range or taken.
    """
    from bokeh.core.validation import silence
    from bokeh.core.validation.warnings import EMPTY_LAYOUT
    from bokeh.server.server import Server

    from mcspectra.app.page import build_page

    silence(EMPTY_LAYOUT)  # which figures fill later
    if as_integer("port", port, least=0, most=65535) == 0:
        with socket.socket() as probe:
            probe.bind((ADDRESS, 0))
            port = int(probe.getsockname()[1])
    try:
        server: Any = Server(
            {"/": build_page},
            port=port,
            address=ADDRESS,
            allow_websocket_origin=[f"{ADDRESS}:{port}", f"localhost:{port}"],
            http_server_kwargs={"max_buffer_size": _MOST_SENT},
            websocket_max_message_size=_MOST_SENT,
        )
    except OSError as error:
        reason = error.strerror or "it is taken"
        raise ParameterError(f"Port {port} cannot be used: {reason}; give another.") from None
    server._http.request_callback = Guard(server._tornado, port)
    return server


def serve(port: int = 0, *, open_browser: bool = True, quiet: bool = False) -> None:
    """Run the explorer until it is interrupted.

    Parameters
    ----------
    port
        As of `make_server`.
    open_browser
        Whether to open the page.
    quiet
        Do not print the address.

    Raises
    ------
    ParameterError
        The port cannot be used.
    """
    import webbrowser

    server = make_server(port)
    # Components repeat, on standard error, what the page says in its own words.
    warnings.simplefilter("ignore")
    # Tabs that close early are no errors; bokeh warns of them, and asserts that their session is made.
    logging.getLogger("bokeh.server.views.ws").setLevel(logging.ERROR)
    logging.getLogger("tornado.application").addFilter(
        lambda record: (
            "GET /ws" not in record.getMessage() or "AssertionError" not in repr(record.exc_info)
        )
    )
    address = f"http://{ADDRESS}:{server.port}/"
    if not quiet:
        print(f"The explorer is at {address}; stop it by Ctrl-C.", flush=True)
    server.start()
    threading.Thread(target=_warm_up, name="explorer warm-up", daemon=True).start()
    if open_browser:
        server.io_loop.add_callback(webbrowser.open, address)
    server.io_loop.start()


def _warm_up() -> None:
    """Load and compile what the first page needs while the browser loads it: half of its wait."""
    from mcspectra.app.compute import KINDS, compute
    from mcspectra.app.state import Setup

    for kind in KINDS:
        compute(kind, Setup(half_width=4), 2)
