"""Methods of prediction with other settings."""

import functools
from dataclasses import replace

import pytest

from mcspectra.estimators import quadrature
from mcspectra.integrands import _quadrature
from mcspectra.prediction import paired, prediction, rates, subsets, torus


@pytest.fixture
def use_settings(monkeypatch):
    """Apply settings to methods by name, for all predictions of a test."""

    def use(**settings):
        methods = tuple(
            replace(each, predict=functools.partial(each.predict, settings=settings[each.name]))
            if each.name in settings
            else each
            for each in prediction.METHODS
        )
        monkeypatch.setattr(prediction, "METHODS", methods)

    return use


@pytest.fixture
def few_products(monkeypatch):
    """Fit at most two products in few sweeps, for tests of other things than the fit.

    The fit misses more of functions that are no products, and predictions state wider intervals.
    A quarter of the cells changes variances by less than 0.1 %, far below `resolved`.
    """
    few = replace(
        subsets.SUBSET_SETTINGS,
        rank=2,
        sweeps=8,
        profile_work=5 << 15,
        fine=1 << 12,
        finest=1 << 16,
    )
    for module in (subsets, paired):
        monkeypatch.setattr(module, "SUBSET_SETTINGS", few)


@pytest.fixture
def few_offsets(monkeypatch):
    """Move sets by a quarter of the offsets, so that intervals are twice as wide."""
    monkeypatch.setattr(torus, "_MOVES", replace(torus._MOVES, offsets=2**11))


@pytest.fixture
def few_probes(request, monkeypatch):
    """Search functions for details at an eighth of the points, for quick tests of other things.

    Integrals of functions that quadrature does not resolve have larger errors.
    """
    if request.node.get_closest_marker("slow"):
        yield
        return
    for module in (_quadrature, quadrature, rates):
        monkeypatch.setattr(module, "PROBE", 2**14)
    _quadrature.probe.cache_clear()
    yield
    _quadrature.probe.cache_clear()
