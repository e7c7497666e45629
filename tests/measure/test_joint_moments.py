"""Estimators that share points: each has the same bits as if it were measured alone."""

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.core import parallel
from mcspectra.core.analysis import compute_chunk
from mcspectra.core.streams import Stream
from mcspectra.measure.converge import MomentsCell, count_moments

ESTIMATORS = [
    mcs.Estimator("gaussian", dims=2),
    mcs.Estimator("disk(radius=0.3)", dims=2),
    mcs.Estimator("gaussian", "linear(slope=1)", dims=2),
]


def test_moments_on_shared_points_equal_separate_moments():
    source, stream = mcs.sampler("jittered", dims=2), Stream.from_rng(4)
    run = MomentsCell(tuple(ESTIMATORS), source, 64, stream).run(0, 3, 700)
    joint = compute_chunk(run, (0, run.blocks))
    for estimator, moments in zip(ESTIMATORS, joint, strict=True):
        alone = count_moments(estimator, source, 64, 700, stream, first=3)
        values = estimator.estimate([source.draw_stream(64, stream, 3, 700)])
        for name in ("count", "mean", "m2", "m3", "m4"):
            assert getattr(moments, name) == getattr(alone, name), name
        # The smallest and largest estimates are exact for any blocks, and so is the largest square
        assert tuple(moments.extremes[[0, -1], 0]) == (values.min(), values.max())
        square = ((values - values.mean()) ** 2).max() / ((values - values.mean()) ** 2).sum()
        assert moments.largest_share[0] == pytest.approx(square, rel=1e-11)
        assert moments.mean[0] == pytest.approx(values.mean(), rel=1e-13)
        assert moments.variance[0] == pytest.approx(values.var(ddof=1), rel=1e-11)


def test_the_size_of_a_cache_changes_no_bit(monkeypatch):
    def curve():
        return mcs.convergence(ESTIMATORS[:2], "jittered | shift", [16, 256], realizations=300)

    before = curve()
    monkeypatch.setattr(parallel, "_SLICE_NUMBERS", 1000)
    after = curve()
    assert np.array_equal(before["variance"], after["variance"])
    assert np.array_equal(before["mean"], after["mean"])


def test_convergence_of_a_list_equals_separate_results():
    mis = mcs.MultipleImportance(
        mcs.integrand("gaussian", dims=2), ["uniform", "linear(slope=1)"], counts=(1, 1)
    )
    for estimators in (ESTIMATORS, [mis, ESTIMATORS[1]]):
        samplers = ["random", "jittered"]
        together = mcs.convergence(estimators, samplers, [4, 16], realizations=50, rng=2)
        for i, estimator in enumerate(estimators):
            for j, sampler in enumerate(samplers):
                alone = mcs.convergence(estimator, sampler, [4, 16], realizations=50, rng=2)
                picked = together.isel(estimator=i, sampler=j)
                for name in ("variance", "mean", "bias", "rate", "realizations_used"):
                    assert np.array_equal(picked[name], alone[name], equal_nan=True), name


@pytest.mark.parametrize("dims", [1, 2, 3, 7])
def test_values_of_gaussian_and_disk_equal_the_formula(dims):
    """Values equal the formula, also for one point, no points, and other memory orders."""
    x = np.random.default_rng(1).random((5, 4, dims))
    gaussian = mcs.integrand("gaussian(center=0.4, width=0.2)", dims=dims)
    disk = mcs.integrand("disk(center=0.4, radius=0.5)", dims=dims)
    square = ((x - 0.4) ** 2).sum(axis=-1)
    for points, s in ((x, square), (x[0, 0], square[0, 0]), (x[:0], square[:0])):
        assert np.allclose(gaussian(points), np.exp(-s / (2 * 0.2**2)), rtol=1e-13, atol=0)
        assert np.array_equal(disk(points), s < 0.25)
        assert gaussian(points).shape == s.shape
    turned = np.asfortranarray(x)
    assert np.array_equal(gaussian(turned), gaussian(x))
    assert np.array_equal(gaussian(x[::2, ::-1]), gaussian(x)[::2, ::-1])
    narrow = mcs.integrand("gaussian(center=0.5, width=1e-310)", dims=dims)
    assert narrow(np.full(dims, 0.5)) == 1.0
    assert narrow(np.full(dims, 0.4)) == 0.0
