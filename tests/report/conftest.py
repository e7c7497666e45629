"""Small results of a study, computed with NumPy only: f(x) = Π x_i and simple samplers."""

import itertools
import math
from collections import defaultdict
from contextlib import contextmanager
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import pytest
import xarray as xr
from tests.fonts import fonts_once
from tests.report.drawing import no_layout, undrawn

import mcspectra as mcs
from mcspectra.core.analysis import ANALYSES
from mcspectra.core.records import pack
from mcspectra.core.results import dataset
from mcspectra.plots import backend_bokeh, backend_matplotlib
from mcspectra.report.bench_page import write_bench
from mcspectra.report.sampler_cards import QUICK, measure_card
from mcspectra.studies.files import Slugs, decode_study, plain_study, study_of
from mcspectra.studies.ledger import Ledger, StudyNote

__all__ = ["fonts_once", "undrawn"]

Z = 1.959963984540054
SAMPLERS = ("random", "jittered", "jittered | shift")


def draw(sampler, n, dims, realizations, seed=1):
    """Return points (R, n, d) of one of `SAMPLERS`."""
    generator = np.random.default_rng(seed)
    x = generator.random((realizations, n, dims))
    if sampler == "random":
        return x
    side = round(n ** (1 / dims))
    cells = np.array(list(itertools.product(range(side), repeat=dims)))
    x = (x + cells) / side
    return (x + generator.random((realizations, 1, dims))) % 1.0 if "shift" in sampler else x


def spectra(points, half_width):
    """Return S_m on the full grid, complex (R, (2K+1)^d), by direct summation per axis."""
    m = np.arange(-half_width, half_width + 1)
    phases = np.exp(-2j * np.pi * points[..., None] * m)  # (R, n, d, 2K+1)
    letters = "abc"[: points.shape[-1]]
    formula = ",".join(f"rn{c}" for c in letters) + f"->r{letters}"
    s = np.einsum(formula, *(phases[:, :, i] for i in range(len(letters))), optimize=True)
    return s.reshape(len(points), -1) / points.shape[1]


def coefficients(half_width, dims):
    """Return f_m of Π x_i on the full grid, flattened."""
    m = np.arange(-half_width, half_width + 1)
    one = np.where(m == 0, 0.5, 1j / (2 * np.pi * np.where(m == 0, 1, m)))
    f = one
    for _ in range(dims - 1):
        f = np.multiply.outer(f, one)
    return f.ravel()


def interval(variance, realizations):
    """Return the interval of a variance of normal values."""
    factor = math.exp(Z * math.sqrt(2 / realizations))
    return np.stack([variance / factor, variance * factor], axis=-1)


def make_terms(
    sampler="jittered",
    *,
    dims=1,
    n=16,
    half_width=16,
    realizations=200,
    matrix=False,
    channels=0,
    techniques=1,
):
    """Return a dataset like `variance_terms`."""
    points = draw(sampler, n, dims, realizations)
    s, f = spectra(points, half_width), coefficients(half_width, dims)
    s = s - s.mean(axis=0)
    each = (f.conj() * s).real
    measured = points.prod(axis=2).mean(axis=1).var(ddof=1)
    shape = (2 * half_width + 1,) * dims
    names = [f"m{i}" for i in range(dims)]
    grid = np.stack(np.meshgrid(*[np.arange(-half_width, half_width + 1)] * dims, indexing="ij"))
    shell = np.rint(np.sqrt((grid**2).sum(axis=0))).astype(int).ravel()
    width = np.abs(grid).max(axis=0).ravel()
    total = each.sum(axis=1)
    diagonal = np.abs(f) ** 2 * (np.abs(s) ** 2).sum(axis=0) / (realizations - 1)
    contribution = (each * total[:, None]).sum(axis=0) / (realizations - 1)
    bands = np.stack([each[:, shell == b].sum(axis=1) for b in range(shell.max() + 1)])
    truncated = np.array(
        [each[:, width <= k].sum(axis=1).var(ddof=1) for k in range(half_width + 1)]
    )
    predicted, centre = total.var(ddof=1), len(f) // 2
    dc, power = diagonal[centre], diagonal.sum() - diagonal[centre]
    values: dict[str, tuple[tuple[str, ...], Any]] = {
        "dc_term": ((), dc),
        "power_term": ((), power),
        "cross_term": ((), predicted - dc - power),
        "cross_term_ci": (("bound",), predicted - dc - power + np.array([-0.1, 0.1]) * predicted),
        "predicted_variance": ((), predicted),
        "predicted_variance_ci": (("bound",), interval(predicted, realizations)),
        "measured_variance": ((), measured),
        "measured_variance_ci": (("bound",), interval(measured, realizations)),
        "captured": ((), predicted / measured),
        "contribution": (tuple(names), contribution.reshape(shape)),
        "power_contribution": (tuple(names), diagonal.reshape(shape)),
        "integrand_power": (tuple(names), (np.abs(f) ** 2).reshape(shape)),
        "band_covariance": (("band", "band_other"), np.cov(bands)),
        "truncated_variance": (("half_width",), truncated),
        "captured_by_half_width": (("half_width",), truncated / measured),
    }
    if techniques > 1:
        for name in ("contribution", "power_contribution", "integrand_power"):
            values[name] = (("technique", *names), np.stack([values[name][1]] * techniques))
    if channels:
        values = {
            name: (("channel", *d), np.stack([np.asarray(v)] * channels))
            for name, (d, v) in values.items()
        }
    coords: dict[str, Any] = {name: np.arange(-half_width, half_width + 1) for name in names}
    if matrix:
        pairs = s.T @ s.conj() / (realizations - 1)
        values["cross_matrix"] = (("m", "l"), f.conj()[:, None] * f[None, :] * pairs)
        coords |= {"m": coords["m0"], "l": coords["m0"]}
    coords |= {"band": np.arange(len(bands)), "half_width": np.arange(half_width + 1)}
    result = dataset(
        values,
        coords,
        n=n,
        realizations=realizations,
        seed=1,
        space="domain",
        coefficients="exact",
    )
    return result.assign_attrs(sampler_spec=sampler, estimator_name="x")


def make_infinite(terms):
    """Replace the spectral part as in `variance_terms` if ∫1/p diverges."""
    changed = terms.copy(deep=True)
    for name in changed.data_vars:
        if "measured" not in str(name):
            infinite = name in ("dc_term", "power_term")
            changed[name] = xr.full_like(changed[name], math.inf if infinite else math.nan)
    return changed.assign_attrs(note="spectral terms are infinite: ∫1/p diverges")


RATES = {"random": -1.0, "jittered": -3.0, "jittered | shift": -2.0}


def make_curve(
    sampler="jittered",
    *,
    rate=None,
    counts=(16, 64, 256, 1024),
    zero=(),
    channels=0,
    half=0.03,
):
    """Return a dataset like `convergence` with a power law; variances with index `zero` are 0."""
    slope = RATES.get(sampler, -1.5) if rate is None else rate
    variance = 0.08 * np.array(counts, dtype=float) ** slope
    variance[list(zero)] = 0.0
    fitted = len(counts) - len(zero) >= 2
    ends = (slope - half, slope + half) if fitted else (math.nan, math.nan)
    values: dict[str, tuple[tuple[str, ...], Any]] = {
        "variance": (("n",), variance),
        "variance_ci": (("n", "bound"), interval(variance, 1000)),
        "mean": (("n",), np.full(len(counts), 0.5)),
        "rate": ((), slope if fitted else math.nan),
        "rate_ci": (("bound",), np.array(ends)),
    }
    if channels:
        values = {
            name: (("channel", *d), np.stack([np.asarray(v)] * channels))
            for name, (d, v) in values.items()
        }
    result = dataset(values, {"n": list(counts)}, realizations=1000, seed=1, fit_last=len(counts))
    return result.assign_attrs(sampler_spec=sampler, estimator_name="x")


def make_spectrum(sampler="jittered", *, dims=1, n=16, half_width=16):
    """Return a dataset like `power_spectrum`."""
    power = (np.abs(spectra(draw(sampler, n, dims, 60), half_width)) ** 2).mean(axis=0)
    names = tuple(f"m{i}" for i in range(dims))
    m = np.arange(-half_width, half_width + 1)
    grid = np.stack(np.meshgrid(*[m] * dims, indexing="ij"))
    ring = np.rint(np.sqrt((grid**2).sum(axis=0))).astype(int).ravel()
    inside = (ring >= 1) & (ring <= half_width)
    size = np.bincount(ring[inside])[1:]
    radial = np.bincount(ring[inside], power[inside])[1:] / size
    result = dataset(
        {
            "power": (names, power.reshape((len(m),) * dims)),
            "radial_power": (("radius",), radial),
        },
        {**dict.fromkeys(names, m), "radius": np.arange(1.0, half_width + 1)},
        n=n,
        realizations=60,
    )
    return result.assign_attrs(sampler_spec=sampler, estimator_name="x")


def make_points(sampler="jittered", *, dims=1, n=16):
    """Return a dataset like a study's cell of points."""
    x, grid = (np.arange(8) + 0.5) / 8, tuple(f"x{axis}" for axis in range(min(dims, 2)))
    f = x if dims == 1 else x[:, None] * x
    values = {
        "points": (("point", "axis"), draw(sampler, n, dims, 1)[0]),
        "integrand_value": (grid, f),
    }
    coords = {"axis": np.arange(dims), **dict.fromkeys(grid, x)}
    return dataset(values, coords, n=n).assign_attrs(sampler_spec=sampler)


GIVEN = {"n": 16, "counts": [16, 64], "target_error": 0.1}
Cells = dict[tuple[str, str], dict[str, xr.Dataset]]


def write_study(folder, cells, title="A study"):
    """Write a ledger like `run_study`; `cells` are by (estimator, sampler) and analysis."""
    found: dict[str, bytes] = {}
    slug, own = Slugs(), defaultdict(Slugs)
    slugs = {name: slug(name) for name in dict.fromkeys(name for name, _ in cells)}
    for (estimator, sampler), analyses in cells.items():
        place = f"{slugs[estimator]}/{own[estimator](sampler)}"
        for analysis, result in analyses.items():
            named = result.assign_attrs(
                estimator_name=estimator, sampler_spec=sampler, analysis=analysis
            )
            found[f"{place}/{analysis}"] = pack(named)
    study = plain_study(study_config(title, cells))
    for entry in study["estimators"]:
        asked = {a for (e, _), analyses in cells.items() if e == entry["name"] for a in analyses}
        for analysis in sorted(asked - entry.keys()):
            fields = msgspec.structs.fields(ANALYSES.load(analysis))
            entry[analysis] = {each.name: GIVEN[each.name] for each in fields if each.required}
    note = StudyNote.of(study_of(study), {})
    with Ledger.create(folder, note, tuple(found)) as ledger:
        for path, payload in found.items():
            ledger.finish(path, payload)
    return folder


def study_config(title, cells):
    """Return the contents of a study file with the estimators and samplers of `cells`."""
    lines = [f"title = {quoted(title)}", "seed = 1"]
    for estimator in dict.fromkeys(e for e, _ in cells):
        samplers = ", ".join(quoted(s) for e, s in cells if e == estimator)
        lines += ["[[estimators]]", f"name = {quoted(estimator)}", 'integrand = "x"']
        lines += [f"samplers = [{samplers}]", "[estimators.terms]", "n = 16"]
    return decode_study("\n".join(lines))


def quoted(text):
    """Return a TOML string."""
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'


def all_analyses(sampler, dims=1, n=None):
    """Return small results of every analysis for one pair."""
    count = n or {1: 16, 2: 16, 3: 27}[dims]
    width = {1: 16, 2: 6, 3: 3}[dims]
    return {
        "convergence": make_curve(sampler),
        "terms": make_terms(sampler, dims=dims, n=count, half_width=width, matrix=dims == 1),
        "spectrum": make_spectrum(sampler, dims=dims, n=count, half_width=width),
        "points": make_points(sampler, dims=dims, n=count),
    }


@contextmanager
def blank_figures():
    """Write figures without contents, for tests of the page around them."""
    # A PDF without bytes would count as not drawn
    white = np.full((2, 2, 3), 255, np.uint8), b" "
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(backend_matplotlib, "draw", lambda plot, **_: None)
        patch.setattr(backend_matplotlib, "rasterize", lambda figure, **_: white)
        patch.setattr(backend_matplotlib, "has_few_colors", lambda figure: True)
        patch.setattr(backend_bokeh, "draw", lambda plot: SimpleNamespace(model=None))
        patch.setattr(backend_bokeh, "packed", lambda model: "blank")
        yield


@pytest.fixture(scope="session")
def bench_page(once, tmp_path_factory):
    """Write the page of a bench of two samplers with their cards; return its path."""

    def written():
        bench = mcs.sampler_bench(["random", "sobol | owen"], counts=[4, 16], realizations=20)
        effort = replace(QUICK, n=16, spectra=6, counts=())
        cards = [measure_card(spec, effort=effort) for spec in bench["sampler"].values]
        folder = tmp_path_factory.mktemp("bench") / "out"
        # Two integrands: a figure of all eight takes most of the time
        with no_layout():
            return write_bench(bench.isel(integrand=slice(2)), str(folder), cards)

    return once("bench-page", written)


@pytest.fixture(name="make", scope="session")
def _make():
    """Return functions that make results, by name."""
    return {
        "terms": make_terms,
        "infinite": lambda **options: make_infinite(make_terms(**options)),
        "curve": make_curve,
        "spectrum": make_spectrum,
        "points": make_points,
        "analyses": all_analyses,
        "study": write_study,
    }


@pytest.fixture(scope="session")
def study_folder(tmp_path_factory):
    """Write a study of three samplers: all analyses in one dim, spectra in two dims."""
    cells: Cells = {("product in 1-D", sampler): all_analyses(sampler, 1) for sampler in SAMPLERS}
    for sampler in SAMPLERS:
        flat = all_analyses(sampler, 2)
        cells["product in 2-D", sampler] = {a: flat[a] for a in ("spectrum", "points")}
    return write_study(tmp_path_factory.mktemp("study"), cells)
