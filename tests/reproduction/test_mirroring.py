"""Mirroring: exact variances by other methods, and wrong inputs that must disagree."""

import numpy as np
import pytest
from scipy.integrate import dblquad

import mcspectra as mcs
from mcspectra.reproduction import mirroring
from mcspectra.reproduction.claims import Measured, judge, known_rate


@pytest.mark.parametrize("mode", ["random", "uniform"])
def test_exact_variances_without_a_shift_by_the_package(mode):
    expected = mcs.exact_variance(mcs.Mirrored(mirroring.INTEGRAND, mode), "jittered", 64)
    assert mirroring.exact_mirrored(mode, 64, homogenized=False) == pytest.approx(
        expected, rel=1e-9
    )


@pytest.mark.parametrize("mode", ["random", "uniform"])
def test_exact_variances_with_a_shift_by_simulation(mode):
    n = 64
    curve = mcs.convergence(
        mcs.Mirrored(mirroring.INTEGRAND, mode), "jittered | shift", [n], realizations=4000, rng=2
    )
    low, high = np.log(curve["variance_ci"].values[0])
    error = (high - low) / 2 / 1.96
    found = np.log(mirroring.exact_mirrored(mode, n, homogenized=True))
    assert abs(found - np.log(float(curve["variance"][0]))) < 4 * error


def test_the_variance_among_images_by_quadrature():
    def squares(y, x):
        f = np.exp(-(x**2) - y**2)
        h = mirroring.symmetrized(np.array(x)) * mirroring.symmetrized(np.array(y))
        return float(f**2 - h**2)

    assert mirroring.among_images() == pytest.approx(dblquad(squares, 0, 1, 0, 1)[0], rel=1e-9)


def test_swapped_rates_disagree():
    study = mcs.improve.mirror_study(
        mirroring.INTEGRAND, "jittered", [64, 256, 1024], mirrorings=["original"],
        realizations=600, rng=1,
    )  # fmt: skip
    cells = {h: study.sel(mirroring="original", homogenized=h) for h in (False, True)}
    n = np.array([64.0, 256.0, 1024.0])
    for homogenized, cell in cells.items():
        right, wrong = (
            mirroring.RATES["original", homogenized],
            -3.5 - mirroring.RATES["original", homogenized],
        )
        assert judge(known_rate("", cell, right, n**right)).agrees is True
        assert judge(known_rate("", cell, wrong, n**wrong)).agrees is False
    moved, plain = (Measured.of(cells[h].isel(n=-1), "variance") for h in (True, False))
    times = moved / plain
    assert 1.0 < times.low < times.value < times.high


def test_the_points_in_the_plot_are_in_copies_of_the_domain():
    """Random: one copy for each point of the strata. Uniform: the same points in all copies."""
    for mode, count in (("random", 64), ("uniform", 16)):
        positions, evaluated = mirroring.placed(mode, 5)
        np.testing.assert_allclose(np.abs(positions), evaluated, atol=1e-12)
        own = mcs.sampler("jittered", 2).draw(count, rng=5)[0]
        inside = positions - np.floor(positions)
        distance = np.abs(inside[:, None] - own).max(axis=-1)
        copies = np.unique(np.floor(positions), axis=0, return_counts=True)[1]
        assert distance.min(axis=1).max() < 1e-12
        assert ((distance < 1e-12).sum(axis=0) == 64 // count).all()
        assert len(copies) == 4
        if mode == "uniform":
            assert copies.tolist() == [16, 16, 16, 16]
