"""Integrals at 4,096 evaluations: `integrate` with and without a profile, SciPy, QMCPy and vegas.

Every method estimates ten integrals with 30 seeds each, all in one run. The methods are:

* ``profile``: `mcspectra.profile` uses a quarter of the evaluations.
  The function `integrate(profile=…)` uses the other three quarters of the evaluations;
* ``after``: like ``profile``, but the profile and the integral use 4,096 evaluations each.
  A function that is integrated repeatedly needs its profile only once;
* ``integrate``: the function `mcspectra.integrate`, called without a profile;
* ``scipy``: 16 scrambled Sobol' sets of SciPy, with Student's t interval;
* ``net``, ``lattice``: QMCPy's CubQMCNetG and CubBayesLatticeG with all evaluations in one set;
* ``vegas``: four iterations adapt the grid and four integrate.
  Each iteration takes an eighth of the evaluations.

A line gives the RMS error of each method.
The number in brackets counts the intervals that contain the integral.
A method is a rival of ``profile`` only if at least 27 of its 30 intervals contain the integral.
The errors of ``profile`` and ``after`` should be at most 1.2 times the error of the best rival.
The output ends with two counts, for ``profile`` and for ``after``:
the number of integrands whose error is at most 1.2 times the error of the best rival.
"""

from __future__ import annotations

import contextlib
import io
import math
import warnings
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
from scipy.special import ndtr, ndtri
from scipy.stats import qmc
from scipy.stats import t as student

import mcspectra as mcs
from mcspectra.core.checks import Array

BUDGET, SEEDS = 4096, 30
HOLDS = 27
SETS = 16
WITHIN = 1.2


def _normal(x: Array) -> Array:
    return np.asarray(ndtri(np.clip(x, 1e-300, 1.0 - 2.0**-53)))


def _asian(x: Array) -> Array:
    steps = _normal(x) * 0.2 / 4.0
    paths = np.exp(np.cumsum(steps - 0.5 * (0.2 / 4.0) ** 2, axis=-1))
    return np.asarray(np.maximum(100.0 * paths.mean(axis=-1) - 100.0, 0.0))


def _logistic(x: Array) -> Array:
    """Likelihood of eight observations of a logistic model with two normal coefficients."""
    z = 2.0 * _normal(x)
    at = np.linspace(-2.0, 2.0, 8)
    signs = np.array([-1.0, -1.0, 1.0, -1.0, 1.0, 1.0, -1.0, 1.0])
    margins = signs * (z[..., :1] + z[..., 1:] * at)
    return np.asarray((1.0 / (1.0 + np.exp(-margins))).prod(axis=-1))


def _ishigami(x: Array) -> Array:
    a = math.pi * (2.0 * x - 1.0)
    return np.asarray(
        np.sin(a[..., 0]) + 7.0 * np.sin(a[..., 1]) ** 2 + 0.1 * a[..., 2] ** 4 * np.sin(a[..., 0])
    )


def _keister(x: Array) -> Array:
    z = _normal(x) / math.sqrt(2.0)
    return np.asarray(math.pi**1.5 * np.cos(np.linalg.norm(z, axis=-1)))


def problems() -> Iterator[tuple[str, Callable[[Array], Array], int, float | None]]:
    """Yield name, function, dims and integral (None if 2^22 points estimate the integral)."""
    oscillatory = np.array([1.0, 0.5, 0.8, 0.3, 0.6])
    waves = np.exp(1j) * ((np.exp(1j * oscillatory) - 1.0) / (1j * oscillatory)).prod()
    yield "Genz oscillatory 5-D", lambda x: np.cos(1.0 + x @ oscillatory), 5, float(waves.real)
    width = 2.0 * (math.atan(1.2) + math.atan(0.8))
    yield "Genz product peak 2-D", lambda x: (1.0 / (0.25 + (x - 0.4) ** 2)).prod(-1), 2, width**2
    yield "Keister 3-D", _keister, 3, 0.5 * math.pi**1.5 * math.exp(-0.25)
    yield "Ishigami", _ishigami, 3, 3.5
    yield "Asian option 16-D", _asian, 16, None
    digital = float(ndtr(-0.25))
    yield "digital option 16-D", lambda x: (_normal(x).sum(-1) > 1.0) * 1.0, 16, digital
    # The trapezoidal rule is exact to rounding for analytic functions that fall like e^(−z²/2)
    z = np.linspace(-9.0, 9.0, 361)
    bell = np.exp(-0.5 * z**2) / math.sqrt(2.0 * math.pi) * (z[1] - z[0])
    grid = np.stack(np.meshgrid(ndtr(z), ndtr(z), indexing="ij"), axis=-1)
    posterior = float(bell @ _logistic(grid) @ bell)
    yield "logistic posterior 2-D", _logistic, 2, posterior
    yield "(xy)^-0.4", lambda x: (x[..., 0] * x[..., 1]) ** -0.4, 2, 1.0 / 0.36
    yield "periodic 4-D", lambda x: (1.0 + 0.5 * np.cos(2.0 * np.pi * x)).prod(-1), 4, 1.0
    yield "kink 2-D", lambda x: np.abs(x.sum(-1) - 0.8), 2, 0.2 + 2.0 * 0.8**3 / 6.0


def _profile(
    f: Any, dims: int, seed: int, *, first: int = BUDGET // 4, then: int = BUDGET - BUDGET // 4
) -> tuple[float, float, float]:
    found = mcs.profile(f, dims=dims, budget=first, rng=seed)
    result = mcs.integrate(f, budget=then, profile=found, rng=1000 + seed)
    return float(result["value"]), *map(float, result["interval"].values)


def _integrate(f: Any, dims: int, seed: int) -> tuple[float, float, float]:
    result = mcs.integrate(f, dims=dims, budget=BUDGET, rng=seed)
    return float(result["value"]), *map(float, result["interval"].values)


def _scipy(f: Any, dims: int, seed: int) -> tuple[float, float, float]:
    sets = [qmc.Sobol(dims, seed=1000 * seed + k).random(BUDGET // SETS) for k in range(SETS)]
    means = np.array([f(points).mean() for points in sets])
    half = student.ppf(0.975, SETS - 1) * means.std(ddof=1) / math.sqrt(SETS)
    return float(means.mean()), float(means.mean() - half), float(means.mean() + half)


def _qmcpy(kind: str) -> Callable[[Any, int, int], tuple[float, float, float]]:
    import qmcpy as qp

    def run(f: Any, dims: int, seed: int) -> tuple[float, float, float]:
        if kind == "net":
            source: Any = qp.DigitalNetB2(dims, seed=seed)
            algorithm = qp.CubQMCNetG
        else:
            source = qp.Lattice(dims, seed=seed, order="RADICAL INVERSE")
            algorithm = qp.CubBayesLatticeG
        g = qp.CustomFun(qp.Uniform(source), lambda x: f(np.clip(x, 0.0, 1.0 - 2.0**-53)))
        cubature = algorithm(g, abs_tol=1e-14, rel_tol=0.0, n_init=BUDGET, n_limit=BUDGET)
        with contextlib.redirect_stdout(io.StringIO()):
            _, data = cubature.integrate()
        value = float(np.squeeze(data.solution))
        return (
            value,
            float(np.squeeze(data.comb_bound_low)),
            float(np.squeeze(data.comb_bound_high)),
        )

    return run


def _vegas(f: Any, dims: int, seed: int) -> tuple[float, float, float]:
    import vegas

    np.random.seed(seed)  # noqa: NPY002 - vegas uses this generator
    integrator = vegas.Integrator([[0.0, 1.0 - 2.0**-53]] * dims)
    batch = vegas.lbatchintegrand(lambda x: f(np.asarray(x)))
    integrator(batch, nitn=4, neval=BUDGET // 8)
    result = integrator(batch, nitn=4, neval=BUDGET // 8)
    half = 1.96 * float(result.sdev)
    return float(result.mean), float(result.mean) - half, float(result.mean) + half


def main(*flags: str) -> None:
    """Print a line for each integrand; ``--only=TEXT`` selects names that contain the text."""
    only = next((flag.split("=", 1)[1] for flag in flags if flag.startswith("--only=")), "")
    warnings.simplefilter("ignore")
    methods = {
        "profile": _profile,
        "after": partial(_profile, first=BUDGET, then=BUDGET),
        "integrate": _integrate,
        "scipy": _scipy,
        "net": _qmcpy("net"),
        "lattice": _qmcpy("lattice"),
        "vegas": _vegas,
    }
    good, count = np.zeros(2, int), 0
    for name, f, dims, integral in problems():
        if only not in name:
            continue
        if integral is None:
            points = mcs.sampler("sobol | owen", dims=dims).draw(2**18, realizations=16, rng=99)
            integral = float(np.mean([f(each).mean() for each in points]))
        errors, holds = dict[str, float](), dict[str, int]()
        for method, run in methods.items():
            found = np.array([run(f, dims, seed) for seed in range(SEEDS)])
            errors[method] = float(np.sqrt(np.nanmean((found[:, 0] - integral) ** 2)))
            slack = 1e-14 * abs(integral)
            holds[method] = int(
                ((found[:, 1] - slack <= integral) & (integral <= found[:, 2] + slack)).sum()
            )
        peers = [m for m in ("scipy", "net", "lattice", "vegas") if holds[m] >= HOLDS]
        best = min((errors[m] for m in peers), default=math.inf)
        ratios = [errors[m] / max(best, 1e-15) for m in ("profile", "after")]
        count += 1
        good += np.array(ratios) <= WITHIN
        cells = "  ".join(f"{m} {errors[m]:.2g} ({holds[m]})" for m in methods)
        print(f"{name:24} {cells}  ratios {ratios[0]:.2g}, {ratios[1]:.2g}", flush=True)
    print(
        f"at most {WITHIN} times the best peer: {good[0]} and, after a profile, {good[1]} of "
        f"{count}"
    )


if __name__ == "__main__":
    main()
