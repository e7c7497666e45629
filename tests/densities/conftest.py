"""Densities of all kinds for the tests that every density must pass."""

import json

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.densities import ImageDensity, Learned, PiecewiseConstant
from mcspectra.densities.learned import DEGREE, SplineDensity


def table(*shape):
    """Return relative densities over three decades, a quarter of them 0."""
    rng = np.random.default_rng(shape)
    return 10 ** rng.uniform(-3, 0, shape) * (rng.random(shape) > 0.25)


def pixel_centers(height, width):
    """Return centers of pixels, (height, width, 2): x_0 over columns, x_1 over rows."""
    rows, columns = ((np.arange(k) + 0.5) / k for k in (height, width))
    return np.stack(np.meshgrid(columns, rows), axis=-1)


def midpoints(side):
    """Return centers of side × side cells, (side², 2)."""
    return pixel_centers(side, side).reshape(-1, 2)


def with_a_jump(x):
    """Return 2x/3 to the left of ½, and 2 (1 − x)/3 + 1 to the right."""
    left = x[..., 0] < 0.5
    return np.where(left, x[..., 0], (1 - x[..., 0]) + 1.5)


SPECS = [
    ("uniform", 1),
    ("uniform", 3),
    ("linear(slope=1)", 1),
    ("linear(slope=2)", 1),
    ("linear(slope=-2)", 1),
    ("linear(slope=1e-9)", 1),
    ("linear(slope=0)", 1),
    ("linear(slope=[1.5, -0.7])", 2),
    ("linear(slope=[2, -2, 0.3, 1, -1, 0, 0.9, 1e-3, 1.9, -1.9])", 10),
    ("aligned-strata(edges=[0.31, 0.7, 0.71], strata=7)", 1),
    ("aligned-strata(edges=[[0.45], [], [0.1, 0.9]], strata=[3, 2, 16])", 3),
    ("truncated-normal", 1),
    ("truncated-normal(mean=3, sigma=0.2)", 1),
    ("truncated-normal(mean=-3, sigma=0.2)", 1),
    ("truncated-normal(mean=0.3, sigma=100)", 1),
    ("truncated-normal(mean=[0, 1, -0.1], sigma=[0.2, 0.01, 1])", 3),
    ("power(exponent=-0.5)", 1),
    ("power(exponent=1000)", 1),
    ("power(exponent=[0, 2.5, 0.3])", 3),
    ("exponential", 1),
    ("exponential(rate=700)", 1),
    ("exponential(rate=-700)", 1),
    ("exponential(rate=[0, -5])", 2),
    ("cosine-weighted", 1),
    ("cosine-weighted", 2),
    ("tent", 1),
    ("tent(peak=0)", 1),
    ("tent(peak=1)", 1),
    ("tent(peak=[0.25, 0.875])", 2),
    ("piecewise-linear(values=[0, 3, 1, 0, 0, 0, 2, 1e-9])", 1),
    ("piecewise-linear(values=[1, 1])", 1),
    ("piecewise-linear(values=[0, 0, 1, 0, 0, 0])", 1),
    ("product(parts=['tent', 'linear(dims=2, slope=[1, 0.5])', 'power'])", 4),
    ("product(parts=['exponential(rate=3)', 'piecewise-constant(values=[2, 0, 1, 3])'])", 2),
    ("mixture(parts=['tent', 'power(exponent=-0.5)'], weights=[1, 3])", 1),
    ("mixture(parts=['uniform', 'tent(peak=0.1)', 'linear'], selection='extra')", 1),
    ("mixture(parts=['tent', 'truncated-normal'], axis=1)", 2),
    ("mixture(parts=['tent', 'linear'], weights=[1e-3, 1], selection='extra')", 2),
    ("mixture(parts=['tent', 'power', 'uniform'], axis=2)", 4),
    ("defensive(density='power(exponent=3)', share=0.2)", 1),
    ("defensive(density='piecewise-constant(values=[[0, 1], [2, 0]])', selection='extra')", 2),
    ("piecewise-constant(values=[0, 3, 1, 0, 0, 2, 0])", 1),
    ("piecewise-constant(values=[5])", 1),
    ("piecewise-constant(values=[[1, 0, 2], [0, 0, 0], [4, 1, 1e-6]])", 2),
    ("piecewise-constant(values=[0, 3, 1, 0, 2], warp='alias')", 1),
    ("piecewise-constant(values=[[1, 0, 2], [0, 0, 0], [4, 1, 0.01]], warp='hierarchical')", 2),
    ("piecewise-constant(values=[[1, 0, 2], [0, 0, 0], [4, 1, 0.01]], warp='alias')", 2),
    ("piecewise-constant(values=[[1, 0, 2], [0, 0, 0], [4, 1, 0.01]], warp='hilbert')", 2),
    ("bilinear(values=[[1, 0, 2], [0.5, 0, 0.1], [4, 1, 0.2]])", 2),
    ("bilinear(values=[[1, 3], [2, 0.5]], nodes='corners')", 2),
    ("environment", 2),
    ("environment(interpolation='bilinear', channel=2)", 2),
    ("disk", 2),
    ('disk(warp="polar", radius=0.2, center=[0.3, 0.6])', 2),
    ('hemisphere(weighting="uniform")', 2),
    ('hemisphere(weighting="uniform", warp="polar")', 2),
    ("hemisphere", 2),
    ('hemisphere(warp="polar")', 2),
    ("sphere", 2),
    ('sphere(warp="polar")', 2),
    ("grid(nodes=[[0, 0.01, 0.3, 1], [0, 0.5, 1]])", 2),
    ("spherical-rectangle", 2),
    ("spherical-rectangle(corner=[3, -1, 0.4], edge0=[0, 0, 2], edge1=[0.5, 3, 0])", 2),
    ("spherical-triangle", 2),
    ("spherical-triangle(a=[1, 0, 0.2], b=[0, 2, 0.1], c=[-1, -1, 0.4])", 2),
]


@pytest.fixture(scope="session")
def picture(tmp_path_factory):
    path = tmp_path_factory.mktemp("pictures") / "table.npy"
    np.save(path, table(5, 9))
    return path


MADE = {
    "table 1-D": lambda: PiecewiseConstant(values=table(613)),
    "table 2-D": lambda: PiecewiseConstant(values=table(13, 7)),
    "hierarchical": lambda: PiecewiseConstant(values=table(13, 7), warp="hierarchical"),
    "alias": lambda: PiecewiseConstant(values=table(13, 7), warp="alias"),
    "hilbert": lambda: PiecewiseConstant(values=table(13, 7), warp="hilbert"),
    "pdf alone 1-D": lambda: mcs.Density.from_functions(pdf=with_a_jump),
    "pdf alone 2-D": lambda: mcs.Density.from_functions(
        pdf=lambda x: np.exp(x[..., 0] * x[..., 1]), dims=2, normalize=True
    ),
    "functions": lambda: mcs.Density.from_functions(
        pdf=lambda x: 2 * x[..., 0], sample=np.sqrt, invert=np.square
    ),
}


def splines(kind, dims):
    """Return tables of a spline density with narrow cells, small weights and a share of 0.02."""
    rng = np.random.default_rng(dims)
    inner = np.sort(10 ** rng.uniform(-1.5, 0, (dims, 6)), axis=1)
    knots = np.concatenate([np.zeros((dims, 1)), inner, np.ones((dims, 1))], axis=1)
    if kind == "flow":
        gates = rng.normal(size=(dims, 9, 1 + dims * DEGREE))
        return SplineDensity(knots=knots, defensive=0.02, gates=gates)
    tables, shares = 10 ** rng.uniform(-4, 0, (3, dims, 9)), rng.random(3)
    tables /= tables.sum(axis=-1, keepdims=True)
    return SplineDensity(knots=knots, defensive=0.02, shares=shares / shares.sum(), tables=tables)


LEARNED = [("mixture", 1), ("mixture", 2), ("mixture", 4), ("flow", 2), ("flow", 3)]


@pytest.fixture(scope="session", params=[*SPECS, *MADE, "picture", *LEARNED], ids=str)
def density(request, picture, tmp_path_factory):
    if request.param in LEARNED:
        path = tmp_path_factory.mktemp("learned") / "density.json"
        path.write_text(json.dumps(splines(*request.param).to_dict()))
        return Learned(path=path)
    if request.param in MADE:
        return MADE[request.param]()
    if request.param == "picture":
        return ImageDensity(path=picture, floor=0.1)
    spec, dims = request.param
    return mcs.density(spec, dims=dims)
