"""Regions with p = 0 and f ≠ 0 are found at any size, without false alarms at zeros of p."""

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.core.errors import DensityError
from mcspectra.densities import Mixture, Product

ONE = {dims: mcs.integrand("constant", dims=dims) for dims in (1, 2, 3, 5)}


def without(low, high):
    """The uniform density on [0,1) without [low, high)."""
    rest = 1 - (high - low)

    def sample(u):
        x = u * rest
        return np.where(x < low, x, x + (high - low))

    return mcs.Density.from_functions(
        pdf=lambda x: np.where((x[..., 0] >= low) & (x[..., 0] < high), 0.0, 1 / rest),
        sample=sample,
    )


@pytest.mark.parametrize(
    ("low", "width"),
    [(0.3, 1e-2), (1 / 3, 1e-4), (0.123456, 1e-6), (0.77, 1e-8), (1e-3, 1e-7), (0.9999, 1e-6)],
)
def test_small_gaps_are_found_in_one_dim(low, width):
    with pytest.raises(DensityError, match="would miss") as caught:
        mcs.Estimator(ONE[1], without(low, low + width))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("end", ["low", "high"])
def test_ends_that_are_left_out_are_found(end):
    width = 3e-4
    p = without(0.0, width) if end == "low" else without(1 - width, 1.0)
    with pytest.raises(DensityError, match="would miss"):
        mcs.Estimator(ONE[1], p)


def test_a_gap_is_fine_where_f_is_zero():
    f = mcs.Integrand.from_function(
        lambda x: np.where(np.abs(x[..., 0] - 0.5) < 0.1, 0.0, 1.0), dims=1, integral=0.8
    )
    mcs.Estimator(f, without(0.45, 0.55))
    mcs.Estimator("step(at=0.5)", "piecewise-constant(values=[1, 0])", dims=1)


@pytest.mark.parametrize("dims", [2, 3])
def test_corners_and_faces_are_probed(dims):
    def corner(x):
        return np.where((x < 2.0**-7).all(axis=-1), 0.0, 1.0)

    p = mcs.densities.FunctionDensity(dims=dims, pdf_function=corner, sample_function=np.sqrt)
    with pytest.raises(DensityError, match="is 0 at"):
        mcs.Estimator(ONE[dims], p)

    def face(x):
        return np.where(x[..., -1] > 1 - 2.0**-11, 0.0, 1.0)

    p = mcs.densities.FunctionDensity(dims=dims, pdf_function=face, sample_function=np.sqrt)
    with pytest.raises(DensityError, match="is 0 at"):
        mcs.Estimator(ONE[dims], p)


def test_the_bright_pixel_of_f_is_probed():
    values = np.zeros((700, 900))
    values[123, 456] = 5
    f = mcs.integrands.Image(values=values)
    np.testing.assert_allclose(f.landmarks(), [[456.5 / 900, 123.5 / 700]])

    def hole(x):
        near = np.abs(x - f.landmarks()[0]).max(axis=-1) < 1e-3
        return np.where(near, 0.0, 1.0)

    p = mcs.densities.FunctionDensity(dims=2, pdf_function=hole, sample_function=np.sqrt)
    with pytest.raises(DensityError, match="would miss"):
        mcs.Estimator(f, p)


def test_both_sides_of_breaks_are_probed():
    """f is 1 left of 0.5; p is 0 right of 0.5 − 1e-7."""
    p = mcs.densities.FunctionDensity(
        dims=2,
        pdf_function=lambda x: np.where(x[..., 0] < 0.5 - 1e-7, 2.0, 0.0),
        sample_function=lambda u: u * np.array([0.5, 1]),
    )
    with pytest.raises(DensityError, match="would miss"):
        mcs.Estimator("step(at=0.5)", p, dims=2)


@pytest.mark.parametrize(
    ("spec", "dims"),
    [
        ("power(exponent=20)", 1),
        ("power(exponent=-0.99)", 1),
        ("tent(peak=0)", 1),
        ("tent", 5),
        ("cosine-weighted", 3),
        ("linear(slope=2)", 2),
        ("exponential(rate=-700)", 1),
        ("piecewise-linear(values=[0, 1, 0, 1, 0])", 1),
        ("mixture(parts=['tent', 'power'], selection='extra')", 1),
        ("mixture(parts=['tent', 'power'])", 1),
    ],
)
def test_zeros_at_points_raise_no_alarm(spec, dims):
    mcs.Estimator(ONE[dims], spec)


def test_several_densities_cover_together():
    parts = [without(0.2, 0.3), without(0.7, 0.8)]
    mcs.MultipleImportance(ONE[1], parts)
    with pytest.raises(DensityError, match="would miss"):
        mcs.MultipleImportance(ONE[1], [parts[0], parts[0]])


@pytest.mark.parametrize("width", [1e-2, 1e-5, 1e-7])
def test_gaps_of_parts_are_found(width):
    part = without(0.3, 0.3 + width)
    for parts in ([part, "tent"], ["tent", part], ["uniform(dims=2)", part]):
        p = Product(parts=parts)
        with pytest.raises(DensityError, match="would miss"):
            mcs.Estimator(ONE[p.dims], p)
    nested = Product(parts=["uniform", Product(parts=[part, part])])
    with pytest.raises(DensityError, match="would miss"):
        mcs.Estimator(ONE[3], nested)
    with pytest.raises(DensityError, match="would miss"):
        mcs.Estimator(ONE[1], Mixture(parts=[part, without(0.3, 0.3 + 2 * width)]))
    mcs.Estimator(ONE[1], Mixture(parts=[part, without(0.7, 0.7 + width)]))
    mcs.Estimator(ONE[1], Mixture(parts=[part, "uniform"]))


def test_gaps_of_a_pdf_alone_are_found_to_the_resolution_of_its_warp():
    low, high = 0.37122, 0.37123
    p = mcs.Density.from_functions(
        pdf=lambda x: np.where((x[..., 0] > low) & (x[..., 0] < high), 0.0, 1 / (1 - (high - low)))
    )
    with pytest.raises(DensityError, match="would miss"):
        mcs.Estimator(ONE[1], p)
