"""Spec strings, arrays and engines become samplers; errors are one sentence."""

import numpy as np
import pytest
from scipy.stats import qmc

import mcspectra as mcs
from mcspectra.core.errors import ParameterError, SpecError, UnknownName
from mcspectra.core.spec import parse_chain
from mcspectra.samplers import as_sampler, sampler
from mcspectra.samplers.registry import sampler_from_calls


def test_the_example_of_the_documentation():
    spelled = sampler("jittered | shift", dims=2)
    chained = mcs.samplers.Jittered(dims=2).then(mcs.samplers.Shift())
    assert spelled == chained
    np.testing.assert_array_equal(
        spelled.draw(256, realizations=10, rng=7), chained.draw(256, realizations=10, rng=7)
    )


def test_dims_come_from_the_call_the_spec_or_the_default():
    assert sampler("jittered").dims == 2
    assert sampler("jittered(dims=3)").dims == 3
    assert sampler("jittered", 5).dims == 5
    with pytest.raises(ParameterError, match="has dims=3, but 2"):
        sampler("jittered(dims=3)", 2)


def test_from_calls_is_from_the_string():
    assert sampler_from_calls(parse_chain("sobol | owen"), 4) == sampler("sobol | owen", 4)


@pytest.mark.parametrize(
    ("spec", "error", "words"),
    [
        ("jittered | shft", UnknownName, "Did you mean 'shift'"),
        ("shift | jittered", SpecError, "'shift' is a randomization, not a sampler"),
        ("shift", SpecError, "'jittered \\| shift'"),
        ("jittered | sobol", SpecError, "'sobol' is a sampler, not a randomization"),
        ("jittered |", SpecError, "does not start with a name"),
        ("", SpecError, "does not start with a name"),
        ("regular(position='middle')", ParameterError, "center, corner"),
        ("jittered | strata-shift(offset=[1, 2, 3])", ParameterError, "3 values"),
        ("jittered | shift(amount=1)", ParameterError, "takes no parameters"),
    ],
)
def test_bad_specs(spec, error, words):
    with pytest.raises(error, match=words):
        sampler(spec)


def test_as_sampler_accepts_arrays_specs_and_engines():
    jittered = sampler("jittered", 2)
    assert as_sampler(jittered) is jittered
    assert sampler(jittered, 2) is jittered
    assert as_sampler("jittered", 2) == jittered
    points = np.random.default_rng(1).random((3, 8, 2))
    np.testing.assert_array_equal(as_sampler(points).draw(8, realizations=3), points)
    assert as_sampler(qmc.Halton, 3).dims == 3
    assert as_sampler(qmc.Halton(d=3)).draw(8, rng=1).shape == (1, 8, 3)


@pytest.mark.parametrize("source", [None, 3, 0.5, b"jittered", [1, 2], {}, object])
def test_other_things_are_refused(source):
    with pytest.raises(ParameterError, match="is not a sampler; give a Sampler, a spec"):
        as_sampler(source)
    with pytest.raises(ParameterError, match="is not a sampler"):
        sampler(source)


def test_dims_that_do_not_fit():
    with pytest.raises(ParameterError, match="2 dims, but 3 dims"):
        as_sampler(sampler("sobol | owen", 2), 3)
    with pytest.raises(ParameterError, match="dims is 0"):
        as_sampler(sampler("sobol", 2), 0)
