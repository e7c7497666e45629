"""Fixtures that run the command in this process."""

import json

import pytest
from tests.fonts import fonts_once
from tests.report.drawing import undrawn

from mcspectra.cli.main import main

__all__ = ["fonts_once", "undrawn"]


@pytest.fixture
def run(capsys):
    """Run the command; return its exit code, output and errors."""

    def call(*arguments):
        code = main([str(a) for a in arguments])
        return code, *capsys.readouterr()

    return call


@pytest.fixture
def run_json(run):
    """Run the command with ``--json``; return its parsed output."""

    def call(*arguments):
        code, out, err = run(*arguments, "--json")
        assert code == 0, err
        return json.loads(out)

    return call
