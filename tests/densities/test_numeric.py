"""∫1/p, divergence, and a check that detects each kind of mismatch."""

import math

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.core.errors import DensityError, ParameterError
from mcspectra.densities import FunctionDensity, PiecewiseConstant, reciprocal_integral


def X(x):
    return x[..., 0]


def Y(x):
    return x[..., 1]


def one(x):
    return np.ones(x.shape[:-1])


def of_pdf(pdf, dims):
    """A density of which only the pdf is used."""
    return FunctionDensity(dims=dims, pdf_function=pdf, sample_function=np.sqrt)


@pytest.mark.parametrize(
    ("pdf", "dims"),
    [
        (lambda x: 2 * X(x), 1),
        (lambda x: 2 * (1 - X(x)), 1),
        (lambda x: 3 * X(x) ** 2, 1),
        (lambda x: 12 * (X(x) - 0.5) ** 2, 1),
        (lambda x: 4 * np.abs(X(x) - 0.5), 1),
        (lambda x: np.abs(X(x) - 1 / math.pi), 1),
        (lambda x: 1 + np.cos(2 * math.pi * X(x)), 1),
        (lambda x: 2.0 * (X(x) < 0.5), 1),
        (lambda x: 4 * X(x) * Y(x), 2),
        (lambda x: 2 * X(x), 2),
        (lambda x: np.abs(X(x) - Y(x)), 2),
        (lambda x: (X(x) - 0.4) ** 2 + (Y(x) - 0.3) ** 2, 2),
        (lambda x: 2.0 * (X(x) < 0.501), 2),
        (lambda x: 8 * np.prod(x, axis=-1), 3),
        (lambda x: 2 * X(x), 4),
    ],
)
def test_divergence_is_found(pdf, dims):
    assert reciprocal_integral(of_pdf(pdf, dims)) == math.inf


@pytest.mark.parametrize(
    ("pdf", "dims", "expected", "relative"),
    [
        (lambda x: 0.5 + X(x), 1, math.log(3), 1e-12),
        (lambda x: 1.5 * np.sqrt(X(x)), 1, 4 / 3, 1e-7),
        (lambda x: 1.5 * np.sqrt(1 - X(x)), 1, 4 / 3, 1e-7),
        (lambda x: 1.9 * X(x) ** 0.9, 1, 10 / 1.9, 1e-6),
        (lambda x: np.sqrt(np.abs(X(x) - 0.31)), 1, 2 * (0.31**0.5 + 0.69**0.5), 1e-6),
        (lambda x: np.where(X(x) < 1 / 3, 2, 0.5), 1, 1 / 6 + 4 / 3, 1e-7),
        (
            lambda x: 1e-6 + (X(x) - 0.5) ** 2,
            1,
            2e3 * math.atan(500),
            1e-9,
        ),  # nearly divergent but finite
        (lambda x: (0.5 + X(x)) * (0.5 + Y(x)), 2, math.log(3) ** 2, 1e-10),
        (lambda x: 2.25 * np.sqrt(X(x) * Y(x)), 2, 16 / 9, 1e-5),
        # p jumps along a circle: 1/p = 2 in a quarter disk of area π R²/4, R² = 0.6, and ½ outside
        (lambda x: np.where((x**2).sum(-1) < 0.6, 0.5, 2), 2, 0.5 + 0.225 * math.pi, 1e-4),
    ],
)
def test_values(pdf, dims, expected, relative):
    assert reciprocal_integral(of_pdf(pdf, dims)) == pytest.approx(expected, rel=relative)


def test_values_in_three_dims_are_estimates():
    found = reciprocal_integral(of_pdf(lambda x: 0.5 + X(x), 3))
    # 1/p lies in [2/3, 2]; 131 072 random points would have a standard error of 1e-3
    assert found == pytest.approx(math.log(3), abs=1e-3)


def test_tables_too_fine_for_the_quadrature():
    values = np.random.default_rng(1).random((130, 70)) + 0.01
    p = PiecewiseConstant(values=values)
    exact = p.reciprocal_integral()
    spread = (1 / p.pdf(np.random.default_rng(2).random((10_000, 2)))).std()
    assert reciprocal_integral(p) == pytest.approx(exact, abs=6 * spread / math.sqrt(131_072))


@pytest.mark.parametrize(
    ("functions", "says"),
    [
        ({"sample": lambda u: u}, "do not follow its pdf"),
        (
            {"sample": lambda u: u, "invert": lambda x: x},
            "sample and invert agree, so the pdf is wrong",
        ),
        ({"sample": lambda u: u, "invert": np.square}, "invert does not undo sample either"),
        ({"invert": lambda x: x}, "sample and pdf agree, so invert is wrong"),
        ({"pdf": X}, "integrates to 0.5"),
        ({"pdf": lambda x: 4 * X(x)}, "integrates to 2"),
        ({"pdf": lambda x: 2.002 * X(x)}, "integrates to 1.001"),
        ({"pdf": lambda x: X(x) - 0.5}, "negative"),
        ({"pdf": lambda x: X(x) * math.nan}, "not finite"),
        ({"pdf": lambda x: one(x) * math.inf}, "not finite"),
        ({"pdf": lambda x: 2 * x}, r"must give \(5,\)\. Write x\[\.\.\., 0\]"),
        ({"pdf": lambda _: 2.0}, r"gave shape \(\)"),
        ({"pdf": lambda x: 2 * X(x) + 0j}, "complex128"),
        ({"pdf": lambda _: "abc"}, "not real numbers"),
        ({"pdf": lambda x: x.nothing}, "failed on points of shape"),
        ({"pdf": 3}, "pdf is 3"),
        ({"sample": lambda u: 2 * u}, "leave"),
        ({"sample": lambda u: u - 0.1}, "leave"),
        ({"sample": lambda u: u * math.nan}, "leave"),
        ({"sample": X}, "gave shape"),
        ({"sample": 3}, "sample is 3"),
        ({"invert": 3}, "invert is 3"),
        ({"invert": lambda x: x * math.nan}, "invert does not undo"),
        ({"invert": X}, "gave shape"),
        ({"pdf": one, "sample": lambda u: u / 2}, "do not follow its pdf"),
        ({"pdf": lambda x: 2 * one(x), "sample": lambda u: u / 2}, "integrates to 2"),
    ],
)
def test_mismatches_in_one_dim(functions, says):
    right = {"pdf": lambda x: 2 * X(x), "sample": np.sqrt}
    with pytest.raises(DensityError, match=says) as caught:
        mcs.Density.from_functions(**{**right, **functions})
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("dims", [2, 3])
@pytest.mark.parametrize(
    ("functions", "says"),
    [
        ({"sample": lambda u: u, "invert": lambda x: x}, "sample and invert agree"),
        ({"invert": lambda x: x}, "so invert is wrong"),
        ({"sample": lambda u: u}, "do not follow its pdf.*invert does not undo"),
        ({"pdf": lambda x: 1.01 * np.prod(2 * x, axis=-1)}, "integrates to 1.01|is 1.01 at"),
    ],
)
def test_mismatches_in_several_dims(dims, functions, says):
    right = {"pdf": lambda x: np.prod(2 * x, axis=-1), "sample": np.sqrt, "invert": np.square}
    assert mcs.Density.from_functions(**right, dims=dims).dims == dims
    with pytest.raises(DensityError, match=says):
        mcs.Density.from_functions(**{**right, **functions}, dims=dims)


def test_samples_that_miss_a_part_in_three_dims():
    def half(u):
        return u * np.array([0.5, 1, 1])

    with pytest.raises(DensityError, match="where samples cover 1"):
        mcs.Density.from_functions(pdf=lambda x: 2 * one(x), sample=half, dims=3)


@pytest.mark.parametrize("dims", [0, -1, 1.5, "2", None])
def test_bad_dims(dims):
    with pytest.raises(ParameterError, match="dims is"):
        mcs.Density.from_functions(pdf=one, sample=np.sqrt, dims=dims)


def test_functions_cannot_change_the_points():
    def greedy(u):
        u *= 0.5
        return u

    with pytest.raises(DensityError, match="read-only"):
        mcs.Density.from_functions(pdf=one, sample=greedy)


def test_valid_densities_raise_no_alarm():
    weights = np.random.default_rng(3).random(500) ** 4
    weights *= 0.999 / weights.mean()
    weights += 0.001
    steps = PiecewiseConstant(values=weights, warp="alias")  # many jumps, and no inverse
    valid = [
        {"pdf": steps.pdf, "sample": steps.sample},
        {"pdf": lambda x: 0.5 / np.sqrt(X(x)), "sample": np.square, "invert": np.sqrt},
        {"pdf": lambda x: 0.1 * X(x) ** -0.9, "sample": lambda u: u**10},
        {"pdf": lambda x: 2.0 * (X(x) < 0.5), "sample": lambda u: u / 2},
        {"pdf": one, "sample": lambda u: 1 - np.abs(1 - 2 * u)},  # a two-to-one warp
        {"pdf": one, "sample": lambda u: (u + 0.3) % 1, "invert": lambda x: (x - 0.3) % 1},
        {
            "pdf": one,
            "sample": lambda u: (u + 0.3) % 1,
            "invert": lambda x: (x - 0.3) % 1,
            "dims": 3,
        },
    ]
    for shape in [(7,), (1000,), (5, 3), (200, 300)]:
        rng = np.random.default_rng(shape)
        p = PiecewiseConstant(values=rng.random(shape) ** 8 * (rng.random(shape) > 0.3))
        valid.append({"pdf": p.pdf, "sample": p.sample, "invert": p.invert, "dims": p.dims})
    for functions in valid:
        mcs.Density.from_functions(**functions)


@pytest.mark.parametrize("sigma", [1e-4, 0.01, 10])
@pytest.mark.parametrize("dims", [1, 2, 5])
def test_narrow_and_wide_peaks_raise_no_alarm(sigma, dims):
    mcs.density(f"truncated-normal(mean=0.3, sigma={sigma})", dims=dims).check()


def test_from_functions_without_an_inverse():
    p = mcs.Density.from_functions(pdf=lambda x: 2 * X(x), sample=np.sqrt)
    assert not p.has_inverse
    assert p.spec == "function"
    assert p.reciprocal_integral() == math.inf
    with pytest.raises(DensityError, match="without an inverse"):
        p.invert([[0.5]])


@pytest.mark.parametrize(
    ("dims", "error"), [(1, 0.015), (1, -0.005), (1, 0.002), (2, 0.015), (2, -0.005)]
)
def test_samples_that_are_slightly_wrong_everywhere_are_found(dims, error):
    """T(u) = u + e u (1 − u) on every axis gives 1/2 + e/4 of the mass to the left half."""
    with pytest.raises(DensityError, match="do not follow its pdf"):
        mcs.Density.from_functions(pdf=one, sample=lambda u: u + error * u * (1 - u), dims=dims)


def test_one_wrong_cell_of_64_is_found():
    """A kink moves 3 % of the mass of one cell to its neighbor."""
    width = 1 / 64

    def sample(u):
        away = np.abs(u - 32 * width)
        return u + 0.03 * np.maximum(0.0, width - away)

    with pytest.raises(DensityError, match=r"fall between \(0.48|fall between \(0.5"):
        mcs.Density.from_functions(pdf=one, sample=sample)


def test_sums_over_cells_of_twice_the_edge():
    from mcspectra.densities.consistency import _doubled

    cells = np.arange(2 * 16.0).reshape(2, 16)
    found = _doubled(cells, 4, 2)
    expected = [
        [c.reshape(4, 4)[i : i + 2, j : j + 2].sum() for i in (0, 2) for j in (0, 2)] for c in cells
    ]
    np.testing.assert_array_equal(found, expected)
    np.testing.assert_array_equal(_doubled(cells[0], 16, 1), cells[0].reshape(8, 2).sum(axis=1))
