"""The algorithms of the detectors use the given settings."""

from dataclasses import replace

import numpy as np
import pytest

from mcspectra.core.errors import ParameterError
from mcspectra.core.streams import Stream
from mcspectra.estimators import as_subject
from mcspectra.explain.causes import CAUSE_SETTINGS, Evidence, causes_of, shares_of
from mcspectra.explain.probing import LINE_SETTINGS, lines_of
from mcspectra.explain.samples import NETS


def subject(function, dims):
    return as_subject(function, "random", dims=dims, lists=False)


def evidence(function, dims, settings=CAUSE_SETTINGS):
    given = subject(function, dims)
    return Evidence.of(given.estimator, given.sampler, 8192, Stream.from_rng(0), settings)


@pytest.mark.parametrize("steps", [16, 32])
@pytest.mark.parametrize("halvings", [8, 12])
@pytest.mark.parametrize("dims", [1, 3])
def test_settings_determine_the_evaluations_of_a_line(dims, halvings, steps):
    settings, made = replace(LINE_SETTINGS, steps=steps, halvings=halvings), 0

    def g(x):
        nonlocal made
        made += len(x)
        return np.exp(x.sum(axis=-1))

    lines = lines_of(g, dims, 2000, np.random.default_rng(0), settings)
    along = int((lines.axis >= 0).sum())
    zoomed = settings.steps + 2 * settings.halvings
    # Displaced probes: one pair per line along an axis, and one pair per group of axes for chords
    aside = (2 * along + 2 * (len(lines.axis) - along) * settings.groups) * (dims > 1)
    assert made == len(lines.axis) * zoomed + 2 * along * len(settings.ends) + aside
    assert along * settings.line + (len(lines.axis) - along) * settings.chord <= 2000


def test_thresholds_change_the_cause_without_new_evaluations():
    seen = evidence(lambda x: np.abs(x[..., 0] - 0.3), 1)
    assert causes_of(seen)[0].name == "kink"
    smooth = replace(seen.lines[0].settings, kink=seen.lines[0].settings.cusp)
    lines = tuple(replace(each, settings=smooth) for each in seen.lines)
    assert causes_of(replace(seen, lines=lines))[0].name == "none"
    many = replace(CAUSE_SETTINGS, least_lines=len(seen.each("axis")) + 1)
    assert causes_of(replace(seen, lines=lines, settings=many))[0].name == "few-realizations"


@pytest.mark.parametrize("dims", [1, 2, 3, 4])
def test_a_smooth_integrand_needs_a_steep_rate(dims):
    """Lines may miss a jump. In up to three dims, the rate of nets shows it nevertheless.

    The rates for a jump are −2, −1.5 and −1.33.
    """
    seen = evidence(lambda x: np.exp(x.sum(axis=-1)), dims)
    assert causes_of(seen)[0].name == "none"
    flat = {**seen.curves, NETS: replace(seen.curves[NETS], rate=-1.2, rate_se=0.05)}
    found = causes_of(replace(seen, curves=flat))[0]
    assert found.name == ("few-realizations" if dims < 4 else "none")
    assert ("n^−1.20" in found.sentence) == (dims < 4)


def test_nested_settings_reach_lines_and_curves():
    lines = replace(LINE_SETTINGS, jump=-1.0, pole=-2.0, kink=-0.5, cusp=-1.0)
    settings = replace(CAUSE_SETTINGS, lines=lines, curves=replace(CAUSE_SETTINGS.curves, slabs=64))
    seen = evidence(lambda x: (x[..., 0] > 0.377) + x[..., 1], 2, settings)
    assert seen.lines[0].settings is lines
    assert seen.lines[0].jumps(seen.scale).sum() == 0
    assert seen.curves["latin-hypercube"].counts[0] == 64


def test_the_number_of_nets_determines_their_size():
    given = subject(lambda x: x[..., 0], 1)
    few = replace(CAUSE_SETTINGS, nets=10)
    _, n, nets = shares_of(given.estimator, given.sampler, 8192)
    _, larger, fewer = shares_of(given.estimator, given.sampler, 8192, few)
    assert (n, nets) == (256, 20)
    assert (larger, fewer) == (512, 10)
    with pytest.raises(ParameterError, match="at least 62"):
        shares_of(given.estimator, given.sampler, 40, few)
