"""Analyses and their doors in Python: every option is an argument with the same default."""

from __future__ import annotations

import inspect
from operator import attrgetter

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
    parameters = inspect.signature(attrgetter(analysis.function)(mcs)).parameters
    options = {
        option.name: inspect.Parameter.empty if option.required else option.default
        for option in options_of(analysis)
    }
    assert options.keys() <= parameters.keys()
    assert {key: parameters[key].default for key in options} == options


@pytest.mark.parametrize("name", CASES)
def test_defaults_are_clean(name):
    for option in options_of(CASES[name]):
        if option.default is not msgspec.NODEFAULT:
            assert option.check(option.default) == option.default
