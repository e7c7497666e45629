"""The directive ``verbs``: the help text of every verb of the command line."""

import contextlib
import io
import os
from unittest.mock import patch

from docutils import nodes
from docutils.parsers.rst import Directive
from sphinx.application import Sphinx

from mcspectra.cli.main import VERBS, main

__all__ = ["VERBS", "help_of", "setup"]


def help_of(*arguments: str) -> str:
    """Return the help text of a verb, 90 columns wide and without colors."""
    printed = io.StringIO()
    plain = {"COLUMNS": "90", "NO_COLOR": "1", "TERM": "dumb"}
    with patch.dict(os.environ, plain), contextlib.redirect_stdout(printed):
        code = main([*arguments, "--help"])
    if code:
        message = f"mcspectra {' '.join(arguments)} --help ended with {code}"
        raise RuntimeError(message)
    return printed.getvalue().rstrip() + "\n"


class _Verbs(Directive):
    def run(self) -> list[nodes.Node]:
        """Return the general help text, then a section for each verb in the same order."""
        overview = nodes.literal_block("", help_of(), language="text")
        return [overview, *map(self._section, VERBS)]

    def _section(self, verb: str) -> nodes.section:
        section = nodes.section(ids=[f"mcspectra-{verb}"], names=[f"mcspectra {verb}"])
        section += nodes.title("", f"mcspectra {verb}")
        section += nodes.literal_block("", help_of(verb), language="text")
        self.state.document.note_explicit_target(section)
        return section


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the directive."""
    app.add_directive("verbs", _Verbs)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
