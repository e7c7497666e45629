"""Strategies return the documented objects, and the library accepts all of them."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from tests.processes import python

import mcspectra as mcs
from mcspectra.core.errors import ParameterError
from mcspectra.testing import strategies

few = settings(max_examples=40, deadline=None, suppress_health_check=list(HealthCheck))
DIMS = st.sampled_from([1, 2, 3, 5])


@few
@given(st.data())
def test_samplers_draw_the_given_counts(data):
    dims = data.draw(DIMS)
    sampler = data.draw(strategies.samplers(dims=dims))
    n = data.draw(strategies.counts(sampler, most=max(64, sampler.nearest_count(1))))
    points = sampler.draw(n, realizations=2, rng=1)
    assert points.shape == (2, n, dims)
    assert points.min() >= 0.0
    assert points.max() < 1.0


@few
@given(st.data())
def test_specs_give_equal_components(data):
    kind = data.draw(st.sampled_from(strategies.COMPONENT_KINDS))
    dims = data.draw(DIMS)
    spec = data.draw(strategies.spec_strings(kind, dims=dims))
    made = getattr(mcs, kind)(spec, dims=dims)
    assert made.dims == dims
    assert getattr(mcs, kind)(made.spec, dims=dims).spec == made.spec


@few
@given(st.data())
def test_densities_and_integrands_can_be_combined(data):
    dims = data.draw(DIMS)
    p = data.draw(strategies.densities(dims=dims))
    f = data.draw(strategies.integrands(dims=dims))
    u = np.random.default_rng(1).random((50, dims))
    x = p.sample(u)
    assert (p.pdf(x) > 0).all()
    np.testing.assert_allclose(p.sample(p.invert(x)), x, atol=1e-9)
    assert np.isfinite(f(x)).all()


@few
@given(st.data(), st.booleans())
def test_point_sets_are_accepted_as_samplers(data, stacked):
    points = data.draw(strategies.point_sets(dims=2, most=8, stacked=stacked))
    assert points.ndim == 2 + stacked
    sampler = mcs.Sampler.from_points(points)
    np.testing.assert_array_equal(
        sampler.draw(points.shape[-2])[0].reshape(-1), points.reshape(-1, points.shape[-2] * 2)[0]
    )


def test_all_cheap_samplers_are_drawn():
    names = strategies._names(2)
    assert {"random", "jittered", "sobol", "poisson-disk", "rank1-lattice"} <= set(names)
    assert not {"bnot", "mitsuba", "points", "digital-net", "shared-cells"} & set(names)


def test_counts_include_all_possible_counts():
    assert strategies.counts("jittered", most=30).elements == (1, 4, 9, 16, 25)
    with pytest.raises(ParameterError, match="cannot make a set of at most 8 points; give most="):
        strategies.counts(mcs.Sampler.from_points(np.full((9, 2), 0.5)), most=8)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: strategies.spec_strings("samplers"), "kind is 'samplers'"),
        (lambda: strategies.samplers(dims=0), "dims is 0"),
        (lambda: strategies.densities(dims=10**9), "dims is 1000000000"),
        (lambda: strategies.integrands(dims=1.5), "dims is 1.5"),
        (lambda: strategies.counts("random", most=np.nan), "most is nan"),
        (lambda: strategies.counts("random", most=10**12), "most is 1000000000000"),
        (lambda: strategies.point_sets(most=0), "most is 0"),
    ],
)
def test_bad_input_gives_an_error(call, words):
    with pytest.raises(ParameterError, match=words):
        call()


def test_checks_work_without_hypothesis_and_strategies_name_it():
    code = (
        "import sys; sys.modules['hypothesis'] = None\n"
        "import mcspectra.testing\n"
        "from mcspectra.core.errors import MissingDependency\n"
        "try:\n    import mcspectra.testing.strategies\n"
        "except MissingDependency as error:\n    print(error)"
    )
    done = python("-c", code, check=True)
    assert "needs hypothesis" in done.stdout
    assert "pip install mcspectra[testing]" in done.stdout
