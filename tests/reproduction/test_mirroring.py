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


def test_the_mirrored_points_in_the_plot_are_images():
    own = mcs.sampler("jittered", 2).draw(16, rng=5)[0]
    x = mcs.sampler("jittered | mirror(mode='uniform')", 2).draw(64, rng=5)[0]
    images = np.concatenate([np.abs(np.array(e) - own) for e in ((0, 0), (0, 1), (1, 0), (1, 1))])
    np.testing.assert_allclose(
        x[np.lexsort(x.round(12).T)], images[np.lexsort(images.round(12).T)], atol=1e-12
    )
