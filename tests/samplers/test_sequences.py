"""Sequences: the first points of a longer set equal the shorter set; effects of skip and mirror."""

import warnings

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.core.errors import CountError, NotPowerOfTwoWarning, ParameterError
from mcspectra.samplers import SAMPLERS
from mcspectra.samplers.base import Structure

SEQUENCES = sorted(name for name in SAMPLERS if SAMPLERS.load(name).sequence)
POINTWISE = ["", " | shift", " | mirror", " | decorrelate"]
SCRAMBLED = ["halton | owen", "halton | permute", "faure | owen", "sobol | owen", "sobol | lms"]


@pytest.mark.parametrize("name", SEQUENCES)
@pytest.mark.parametrize("chain", POINTWISE)
def test_the_first_points_do_not_depend_on_how_many_there_are(name, chain):
    dims = 1 if name == "van-der-corput" else 2
    check_first_points(mcs.sampler(name + chain, dims=dims))


@pytest.mark.filterwarnings("ignore::mcspectra.core.errors.NotPowerOfTwoWarning")
@pytest.mark.parametrize("spec", SCRAMBLED)
def test_the_first_scrambled_points_do_not_depend_on_the_count(spec):
    check_first_points(mcs.sampler(spec, dims=2))


def check_first_points(source):
    assert source.sequence
    long, short = (source.draw(n, realizations=3, rng=5) for n in (64, 16))
    np.testing.assert_array_equal(long[:, :16], short)


@pytest.mark.parametrize(
    "chain",
    ["subset", "shuffle", "mirror(mode='uniform')", "random-rotation(boundary='clipped')"],
)
def test_steps_that_reorder_points_destroy_the_sequence(chain):
    assert not mcs.sampler(f"sobol | {chain}").sequence
    with pytest.raises(ParameterError, match="skip would break the uniform coverage"):
        mcs.sampler(f"sobol | {chain} | skip(count=4)")


@pytest.mark.parametrize(
    "spec",
    [
        "jittered | subset(of=16)",
        "jittered | mirror",
        "hammersley",
        "larcher-pillichshammer",
        "larcher-pillichshammer | owen",
        "digital-net(matrices=[[2, 1], [2, 3]])",
        "best-candidate",
    ],
)
def test_skip_requires_a_sequence(spec):
    with pytest.raises(ParameterError, match="which is not a sequence"):
        mcs.sampler(f"{spec} | skip(count=4)")


def test_skipped_points_of_a_kronecker_sequence_are_those_that_follow():
    whole = mcs.sampler("kronecker").draw(24)[0]
    np.testing.assert_array_equal(mcs.sampler("kronecker | skip(count=8)").draw(16)[0], whole[8:])


@pytest.mark.parametrize("step", ["skip(count=1)", "skip(count=24)"])
def test_runs_of_a_net_that_begin_off_a_multiple_warn(step):
    with pytest.warns(NotPowerOfTwoWarning, match="after the first"):
        mcs.sampler(f"sobol | {step}").draw(16)


def test_balanced_runs_and_parts_do_not_warn():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        mcs.sampler("sobol | skip(count=32)").draw(16)
        mcs.sampler("sobol | subset(of=128)").draw(100)


@pytest.mark.parametrize("step", ["skip(count=2147483648)", "subset(of=2147483648)"])
def test_parts_of_sets_larger_than_memory_are_refused(step):
    with pytest.raises(ParameterError, match="points in 2 dims first"):
        mcs.sampler(f"random | {step}")


def test_the_largest_count_goes_through_the_steps():
    images = mcs.sampler("ldbn | mirror(mode='uniform')")
    assert images.max_count == 4 * mcs.sampler("ldbn").max_count
    assert (
        mcs.sampler("sobol | skip(count=1024)").max_count == mcs.sampler("sobol").max_count - 1024
    )


def test_mirror_images_lie_close_to_one_another():
    assert mcs.sampler("poisson-disk | mirror(mode='uniform')").structure is Structure.NONE
    assert mcs.sampler("jittered | mirror(mode='uniform')").structure is Structure.STRATA


@pytest.mark.parametrize(
    ("spec", "n", "nearest"),
    [
        ("hammersley | owen", 18, (16, 32)),
        ("hammersley | digital-shift", 3, (2, 4)),
        ("correlated-multi-jittered | owen(base=3)", 27, (9, 81)),
        ("correlated-multi-jittered | owen", 24, (16, 32)),
    ],
)
def test_counts_of_sets_with_digits_at_powers_only(spec, n, nearest):
    with pytest.raises(CountError) as error:
        mcs.sampler(spec).draw(n)
    assert error.value.nearest == nearest


@pytest.mark.parametrize("step", ["owen", "owen(method='hash')", "lms"])
def test_scrambles_that_separate_antithetic_pairs_are_refused(step):
    with pytest.raises(ParameterError, match="would break the pairs of antithetic-jittered"):
        mcs.sampler(f"antithetic-jittered | {step}")


@pytest.mark.parametrize("step", ["digital-shift", "permute"])
def test_digital_shifts_keep_antithetic_pairs(step):
    """The mean of a pair is the center of a cell, so the mean of all points is exactly ½."""
    points = mcs.sampler(f"antithetic-jittered | {step}").draw(32, realizations=10, rng=1)
    np.testing.assert_allclose(points.mean(axis=1), 0.5, atol=1e-15)


def test_linear_scrambling_keeps_strata():
    points = mcs.sampler("jittered | lms").draw(64, realizations=20, rng=1)
    for cells in np.floor(8 * points).astype(int):
        assert len(np.unique(cells, axis=0)) == 64


def test_symmetries_keep_nets_whose_digits_have_one_base():
    assert mcs.sampler("sobol | random-rotation").structure is Structure.DIGITS
    assert mcs.sampler("halton | random-rotation").structure is Structure.TORUS
    points = mcs.sampler("sobol | random-rotation | owen").draw(64, realizations=20, rng=1)
    for a in range(7):
        cells = np.floor(points * [2**a, 2 ** (6 - a)]).astype(int)
        assert all(len(np.unique(each, axis=0)) == 64 for each in cells)


def test_scrambled_rectangles_keep_their_cells():
    points = mcs.sampler("correlated-multi-jittered | owen").draw(32, realizations=20, rng=1)
    cells = np.floor(points * [4, 8]).astype(int)
    for each in cells:
        assert len(np.unique(each, axis=0)) == 32
