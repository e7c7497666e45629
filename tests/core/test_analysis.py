"""Analyses and their doors in Python: every option is an argument with the same default."""

from __future__ import annotations

import inspect

import msgspec
import pytest

import mcspectra as mcs
from mcspectra.core.analysis import ANALYSES
from mcspectra.core.errors import MissingDependency
from mcspectra.core.options import options_of


def _with_functions():
    """All analyses that load and have a function in Python."""
    for name in ANALYSES:
        try:
            found = ANALYSES.load(name)
        except MissingDependency:
            continue
        if found.function:
            yield name, found


CASES = dict(_with_functions())


@pytest.mark.parametrize("name", CASES)
def test_functions_have_the_options_with_their_defaults(name):
    analysis = CASES[name]
    parameters = inspect.signature(getattr(mcs, analysis.function)).parameters
    for option in options_of(analysis):
        if not option.required:
            assert parameters[option.name].default == option.default
        elif option.name != "counts" or "counts" in parameters:  # some take one number, n, too
            assert parameters[option.name].default is inspect.Parameter.empty


@pytest.mark.parametrize("name", CASES)
def test_defaults_are_clean(name):
    for option in options_of(CASES[name]):
        if option.default is not msgspec.NODEFAULT:
            assert option.check(option.default) == option.default
