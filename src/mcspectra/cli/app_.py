"""Explore in the browser: choose a sampler, a density and an integrand, and see what they make.

Serves a page on this machine alone, without any use of the network; needs the extra app.
"""

from __future__ import annotations

import argparse
import importlib

from mcspectra.cli.common import Answer, adder, whole
from mcspectra.core.errors import MissingDependency, ParameterError

__all__ = ["add_arguments", "run"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verb's options."""
    add = adder(parser)
    add("--port N", "port on this machine; any free one by default", whole(0, 65535), default=0)
    add("--no-browser", "print the address, open no browser")


def run(options: argparse.Namespace) -> Answer:
    """Serve until interrupted."""
    if options.json or options.seed is not None:
        raise ParameterError("app takes neither --json nor --seed; choose the seed on the page.")
    try:
        importlib.import_module("panel")
    except ImportError:
        raise MissingDependency(
            "The explorer needs Panel; install it with pip install 'mcspectra[app]'."
        ) from None
    from mcspectra.app.server import serve

    serve(options.port, open_browser=not options.no_browser, quiet=options.quiet)
    return Answer()
