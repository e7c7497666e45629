"""Refusals of densities: a table of fields and bad values."""

import math

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.core.environments import synthetic_sky
from mcspectra.core.errors import DensityError, DomainError, FileFormatError, ParameterError
from mcspectra.densities import DENSITIES, Linear, Mixture, Tent, compensated

HUGE = np.broadcast_to(1.0, (10**6, 10**6))
NO_TABLES = [[], [[]], 3, None, "12", ["1", "2"], [[1, 2], [3]], [[[1.0]]], [0, 0], [1, -1]]
NO_TABLES += [[1, math.nan], [1, math.inf], [1j, 2], {}, [10**400], HUGE]
NO_NUMBERS = [None, "1", True, math.nan, math.inf, [], [1, 2, 3], [[1, 1]], [0, math.nan]]
NO_COUNTS = [0, -1, 1.5, "2", True, math.nan, 10**9]
NO_VECTORS = [
    (0, 0),
    (0, 0, math.nan),
    (0, 0, math.inf),
    (0, 0, 1e300),
    "abc",
    None,
    [[0, 0, 1]] * 3,
]
NO_WARPS = ["aliased", "", None, 3, ["alias"], "Alias"]
PARTS = [Tent(dims=1, peak=0.3), Linear(dims=1, slope=1)]
SKY = synthetic_sky(6, 10)

# Density name, required fields, bad values of other fields; the error names the field
FIELDS = [
    ("uniform", {}, {"dims": [*NO_COUNTS, None]}),
    ("linear", {}, {"dims": NO_COUNTS, "slope": [*NO_NUMBERS, 2.0001, -2.5]}),
    ("power", {}, {"dims": NO_COUNTS, "exponent": [*NO_NUMBERS, -1, -0.991, 1001]}),
    ("exponential", {}, {"dims": NO_COUNTS, "rate": [*NO_NUMBERS, 701, -701]}),
    ("tent", {}, {"dims": NO_COUNTS, "peak": [*NO_NUMBERS, -0.1, 1.1]}),
    ("cosine-weighted", {}, {"dims": NO_COUNTS}),
    ("truncated-normal", {}, {"sigma": [*NO_NUMBERS, 0, -1, 101], "mean": NO_NUMBERS}),
    ("truncated-normal", {"sigma": 0.2}, {"mean": [30, -21, [0.5, 30]]}),
    ("piecewise-constant", {}, {"values": NO_TABLES}),
    ("piecewise-constant", {"values": [1, 2]}, {"warp": NO_WARPS}),
    ("piecewise-linear", {}, {"values": [*NO_TABLES[:-1], [1], [[1, 2], [3, 4]]]}),
    ("bilinear", {}, {"values": [*NO_TABLES, [1, 2]]}),
    ("bilinear", {"nodes": "corners"}, {"values": [[[1, 2]]]}),
    ("bilinear", {"values": [[1]]}, {"nodes": ["center", None], "periodic": [1, None]}),
    ("bilinear", {"values": [[1, 2]] * 2, "nodes": "corners"}, {"periodic": [True]}),
    ("disk", {}, {"radius": [0, 0.51, 1e-7, math.nan, "a", True], "warp": ["square", None]}),
    ("disk", {}, {"center": [(0.5, 0.5, 0.5), (0.5, math.inf), None]}),
    ("hemisphere", {}, {"weighting": ["sine", None], "warp": ["octahedral"]}),
    ("sphere", {}, {"warp": [3, "x"]}),
    ("spherical-rectangle", {}, {"corner": NO_VECTORS, "origin": [("a", 0, 0)]}),
    ("spherical-triangle", {}, {"c": [[1, 2, 3, 4], *NO_VECTORS]}),
    ("grid", {}, {"nodes": [[], None, 3, "ab", [[0, 1], [0]], [[0, 0.5, 0.5, 1]], [[0, 2]]]}),
    ("grid", {}, {"nodes": [[[0, 0.7, 0.3, 1]], [[0.1, 1]], [[0, math.nan, 1]], [[0, 1e-17, 1]]]}),
    ("grid", {}, {"nodes": [[[[0, 1]]], [np.linspace(0, 1, 5000)], [[0, 1]] * 100]}),
    ("grid", {}, {"nodes": [[0, [0.5], 1], [0, 0.5], [0], [0, math.nan, 1]]}),
    ("environment", {}, {"channel": [3, "red"], "interpolation": ["cubic"], "warp": ["none"]}),
    ("environment", {}, {"compensation": [-1, math.nan, "yes"], "sin_theta": [1, None]}),
    ("mixture", {}, {"parts": [[], "tent", None, ["tent"] * 1025, ["tent", None]]}),
    ("mixture", {"parts": PARTS}, {"dims": [0, -1], "axis": [1, -1], "selection": ["extr"]}),
    ("mixture", {"parts": PARTS}, {"weights": [[1], 1, [1, 0], [1, -1], [1, math.nan]]}),
    ("mixture", {"parts": PARTS}, {"weights": [[1, math.inf], [1e308, 1e308], ["a", "b"]]}),
    ("defensive", {"density": PARTS[0]}, {"share": [0, 1, 1.5, -0.1, math.nan, "a", None]}),
    ("product", {}, {"parts": [[], "linear", None, [None], ["linear(dims=1024)", "linear"]]}),
]
CASES = [
    pytest.param(name, needed, field, values, id=f"{name}-{field}-{i}")
    for i, (name, needed, fields) in enumerate(FIELDS)
    for field, values in fields.items()
]


@pytest.mark.parametrize(("name", "needed", "field", "values"), CASES)
def test_bad_values_of_a_field_are_named(name, needed, field, values):
    cls = DENSITIES.load(name)
    for value in values:
        with np.errstate(over="ignore"), pytest.raises(ParameterError) as caught:
            cls(**needed, **{field: value})
        assert field in str(caught.value), value
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "options", "error", "says"),
    [
        ("truncated-normal", {"mean": 30, "sigma": 0.2}, ParameterError, "100 sigma"),
        ("disk", {"center": (0.1, 0.5)}, ParameterError, "between 0.5 and 0.5"),
        ("disk", {"center": 0.6}, ParameterError, "leaves the unit square"),
        ("spherical-rectangle", {"edge0": (0, 0, 0)}, ParameterError, "no area"),
        ("spherical-rectangle", {"edge0": (0, 2, 0)}, ParameterError, "no area"),
        ("spherical-rectangle", {"edge0": (1, 1, 0)}, ParameterError, "right angles"),
        ("spherical-rectangle", {"origin": (5, 5, 1)}, ParameterError, "in the plane"),
        ("spherical-rectangle", {"origin": (0, 0, 1 - 1e-8)}, ParameterError, "in the plane"),
        (
            "spherical-rectangle",
            {"corner": (0, 0, 1e7), "edge0": (1e-3, 0, 0)},
            ParameterError,
            "has an edge of 0.001",
        ),
        ("spherical-triangle", {"c": (1.5, -0.5, 1)}, ParameterError, "no area"),
        ("spherical-triangle", {"a": (0.5, -0.5, 1)}, ParameterError, "no area"),
        ("spherical-triangle", {"origin": (0, 0, 1)}, ParameterError, "in the plane"),
        ("environment", {"values": np.zeros((2, 2))}, DensityError, "is black"),
        (
            "environment",
            {"values": np.ones((4, 8)), "compensation": True},
            DensityError,
            "leaves nothing",
        ),
        ("environment", {"values": SKY, "compensation": 1e9}, DensityError, "1e\\+09 times"),
        ("environment", {"interpolation": "bilinear", "warp": "alias"}, ParameterError, "marginal"),
        ("environment", {"values": SKY, "path": "sky.exr"}, ParameterError, "give one of them"),
        ("environment", {"values": -SKY}, ParameterError, "at least 0"),
        ("environment", {"values": SKY * math.nan}, ParameterError, "finite"),
        ("environment", {"values": SKY * math.inf}, ParameterError, "finite"),
        ("environment", {"values": [1, 2]}, ParameterError, r"shape \(2,\)"),
        ("environment", {"values": np.ones((0, 3))}, ParameterError, r"shape \(0, 3\)"),
        ("environment", {"values": "sky"}, ParameterError, "not an array of numbers"),
        ("environment", {"values": [[1, 2], [3]]}, ParameterError, "not an array of numbers"),
        ("environment", {"values": SKY * 1j}, ParameterError, "not an array of numbers"),
        ("environment", {"values": HUGE}, ParameterError, "the limit"),
        ("environment", {"path": 3}, FileFormatError, "3 is not a path"),
        ("environment", {"path": "no-such.exr"}, FileFormatError, "no file"),
        ("image", {"path": "none.png"}, FileFormatError, "no file"),
        ("image", {"path": None}, FileFormatError, "is not a path"),
        ("mixture", {"parts": ["tent", 3]}, ParameterError, "is not a density"),
        ("mixture", {"parts": ["tentt"]}, ParameterError, "Did you mean 'tent'"),
        ("mixture", {"parts": [Tent(dims=1), Tent(dims=2)]}, ParameterError, "same number of dims"),
        ("mixture", {"parts": PARTS, "dims": 2}, ParameterError, "same number of dims"),
        ("mixture", {"parts": PARTS, "selection": "split"}, ParameterError, "split_mixture"),
        (
            "mixture",
            {"parts": [Mixture(parts=PARTS, selection="extra")]},
            ParameterError,
            "extra coordinate",
        ),
        ("defensive", {"density": None}, ParameterError, "None"),
        ("defensive", {"density": 3}, ParameterError, "is not a density"),
        ("product", {"parts": [1.5]}, ParameterError, "is not a density"),
        ("product", {"parts": ["no-such"]}, ParameterError, "no density"),
        ("product", {"parts": ["linear(slope=3)"]}, ParameterError, "slope is 3"),
        ("product", {"parts": ["linear | linear"]}, ParameterError, "chains"),
    ],
)
def test_incompatible_options_are_named(name, options, error, says):
    with pytest.raises(error, match=says) as caught:
        DENSITIES.load(name)(**options)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("spec", "dims", "says"),
    [
        ("cosine-weighted(power=2)", 1, "no parameter"),
        ("disk", 3, "dims"),
        ("sphere", 3, "dims"),
        ("spherical-triangle", 3, "dims"),
        ("product(parts=['tent', 'tent'])", 3, "2 dims, but 3"),
        ("piecewise-linear(values=[1, 2])", 2, "1 dim, but 2"),
        ("piecewise-constant(values=[1, 2])", 2, "for 1 dim, but 2"),
        ("piecewise-constant", 2, "needs values"),
        ("uniform | uniform", 1, "chains"),
        ("", 1, "name"),
    ],
)
def test_bad_specs(spec, dims, says):
    with pytest.raises(ParameterError, match=says) as caught:
        mcs.density(spec, dims=dims)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("method", ["pdf", "sample", "invert"])
@pytest.mark.parametrize(
    ("points", "says"),
    [
        ([[0.5, math.nan]], "NaN"),
        ([[0.5, math.inf]], "infinity"),
        ([[0.5, 1.5]], "from 0.5 to 1.5"),
        ([[0.5, -0.1]], "from -0.1"),
        ([0.5], "shape"),
        (0.5, "shape"),
        ("abc", "not an array"),
        ([[0.1], [0.2, 0.3]], "not an array"),
        (None, "not an array"),
    ],
)
def test_bad_points(method, points, says):
    with pytest.raises(DomainError, match=says):
        getattr(mcs.density("linear", dims=2), method)(points)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"channel": 3}, "channel is 3"),
        ({"channel": -1}, "channel is -1"),
        ({"channel": "red"}, "channel is 'red'"),
        ({"channel": 0.5}, "channel is 0.5"),
        ({"channel": None}, "channel is None"),
        ({"floor": -1}, "floor is -1"),
        ({"floor": math.nan}, "floor is nan"),
        ({"linear": 1}, "linear is 1"),
        ({"warp": "none"}, "warp is 'none'"),
    ],
)
def test_bad_picture_options(tmp_path, options, says):
    np.save(tmp_path / "p.npy", np.ones((2, 2, 3)))
    with pytest.raises(ParameterError, match=says):
        DENSITIES.load("image")(path=tmp_path / "p.npy", **options)


@pytest.mark.parametrize(
    ("pixels", "error", "says"),
    [
        (np.zeros((2, 2)), DensityError, "black"),
        (np.array([[1.0, -1.0]]), DensityError, "1 negative"),
        (np.ones((2, 2, 4)), ParameterError, "channel instead"),
    ],
)
def test_bad_pictures(tmp_path, pixels, error, says):
    np.save(tmp_path / "p.npy", pixels)
    with pytest.raises(error, match=says):
        mcs.density(f"image(path={str(tmp_path / 'p.npy')!r})")


@pytest.mark.parametrize(
    ("density", "others", "counts", "words"),
    [
        ("linear(slope=1)", ["uniform"], None, "not a table"),
        (3, ["uniform"], None, "not a density"),
        (None, ["uniform"], None, "not a table"),
        ("piecewise-constant(values=[1, 2])", [None], None, "None"),
        ("piecewise-constant(values=[1, 2])", ["unifrom"], None, "uniform"),
        ("piecewise-constant(values=[1, 2])", [Linear(dims=2)], None, "dims"),
        ("piecewise-constant(values=[1, 2])", ["uniform"], (1,), "2 numbers"),
        ("piecewise-constant(values=[1, 2])", ["uniform"], (1, 0), "at least 1"),
        ("piecewise-constant(values=[1, 2])", ["uniform"], (1, math.nan), "whole"),
        ("piecewise-constant(values=[1, 2])", ["uniform"], 2, "2 numbers"),
        ("piecewise-constant(values=[1, 2])", "uniform", None, "list"),
    ],
)
def test_bad_compensation(density, others, counts, words):
    with pytest.raises(ParameterError, match=words):
        compensated(density, others, counts)
