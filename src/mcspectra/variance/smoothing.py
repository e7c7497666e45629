"""Smoothing of edges measured: bias against variance, and the width that suits a sample budget.

A jump across a hypersurface costs jittered samples n^(−1 − 1/d); a ramp of width δ has the rate of
smooth integrands once strata are narrower than δ (in 1-D the variance is then 1/(12 δ n³)), and a
bias that does not go down with n. The width with the least mean squared error thus depends on n.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from mcspectra.core.checks import Array, as_real
from mcspectra.core.errors import ParameterError
from mcspectra.core.results import dataset
from mcspectra.core.streams import RngLike
from mcspectra.densities import Density
from mcspectra.estimators import Estimator
from mcspectra.integrands import Integrand, as_integrand, integral_accuracy
from mcspectra.integrands.smoothing import BoxSmoothed, smoothed
from mcspectra.samplers import Sampler
from mcspectra.variance.convergence import convergence

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["smoothing_scan"]

_MOST_WIDTHS = 256


def smoothing_scan(
    integrand: Integrand | str,
    sampler: Sampler | str,
    counts: int | Sequence[int],
    widths: Sequence[float],
    *,
    density: Density | str | None = None,
    method: str = "auto",
    realizations: int = 1000,
    rng: RngLike = 0,
    workers: int | None = None,
) -> xr.Dataset:
    """Measure bias, variance and rate of an integrand with edges smoothed over several widths.

    Parameters
    ----------
    integrand
        f, or its spec string.
    sampler, counts
        A sampler and one number of points n or ascending ones, in whose number the rate needs two.
    widths
        δ, ascending, each as for `mcspectra.smoothed`; 0 is f itself.
    density
        Importance density, as for `mcspectra.Estimator`.
    method
        As for `mcspectra.smoothed`.
    realizations, rng, workers
        As for `mcspectra.convergence`; all widths share random numbers.

    Returns
    -------
    xarray.Dataset
        ``variance(width, n)`` with ``variance_ci``; ``smoothing_bias(width)``, of the integrals, and
        ``bias_squared(width)`` with ``bias_squared_ci``, by how well the integrals are known;
        ``mse(width, n)`` = bias² + variance with ``mse_ci``; ``rate(width)`` of the variance with
        ``rate_ci``; ``best_width(n)``, that of the least mse, and ``best_width_range(n, bound)``, of all
        widths whose interval reaches below the top of that interval. Several channels add a dim
        channel; the best width is that of the sum over them.

    Raises
    ------
    CountError, ParameterError
        The sampler cannot do a count, widths are not ascending or cannot be done, dims disagree.

    Examples
    --------
    >>> import mcspectra as mcs
    >>> d = mcs.smoothing_scan("disk(center=0.47)", "jittered", 256, [0, 0.05, 0.2], rng=1)
    >>> float(d["best_width"][0])
    0.05
    """
    f = as_integrand(integrand, getattr(sampler, "dims", None))
    places = _check_widths(widths)
    functions = [smoothed(f, w, method=method) if w else f for w in places]
    measured = convergence(
        [Estimator(g, density) for g in functions],
        sampler,
        counts if isinstance(counts, Sequence | np.ndarray) else [counts],
        realizations=realizations,
        rng=rng,
        workers=workers,
    ).rename(estimator="width")
    bias, square_ci = _biases(f, functions)
    axes = ("width", "channel")[: bias.ndim]
    variables: dict[str, tuple[tuple[str, ...], Any]] = {
        name: (tuple(map(str, measured[name].dims)), measured[name].values)
        for name in ("variance", "variance_ci", "rate", "rate_ci")
    }
    mse = variables["variance"][1] + np.expand_dims(bias**2, 1)
    mse_ci = variables["variance_ci"][1] + np.expand_dims(square_ci, 1)
    best, span = _best(np.array(places), *_summed(mse, mse_ci, f.channels))
    variables |= {
        "smoothing_bias": (axes, bias),
        "bias_squared": (axes, bias**2),
        "bias_squared_ci": ((*axes, "bound"), square_ci),
        "mse": (variables["variance"][0], mse),
        "mse_ci": (variables["variance_ci"][0], mse_ci),
        "best_width": (("n",), best),
        "best_width_range": (("n", "bound"), span),
    }
    width = ("width", places, {"long_name": "width of smoothed edges", "units": "1"})
    return dataset(
        variables,
        {"width": width, "n": measured["n"], "bound": measured["bound"]},
        integrand=f.spec,
        method=method,
        **{key: measured.attrs[key] for key in ("sampler", "realizations", "stream_key")},
        seed=rng if isinstance(rng, int) else None,
    )


def _check_widths(widths: Any) -> list[float]:
    if not isinstance(widths, Sequence | np.ndarray) or isinstance(widths, str):
        raise ParameterError(f"widths is {widths!r:.80}; give a list of ascending widths.")
    if len(widths) > _MOST_WIDTHS:
        raise ParameterError(f"widths has {len(widths)} values; give {_MOST_WIDTHS} at most.")
    places = [as_real(f"widths[{i}]", w, least=0.0) for i, w in enumerate(widths)]
    if not places or sorted(set(places)) != places:
        raise ParameterError(f"widths is {widths!r:.80}; give one or more, ascending.")
    return places


def _biases(f: Integrand, functions: list[Integrand]) -> tuple[Array, Array]:
    """∫ f_δ − ∫ f, (W[, channels]), and the interval of its square, (…, 2), by what is known of both."""
    same = [g is f or isinstance(g, BoxSmoothed) for g in functions]  # boxes keep the integral
    error = np.array(
        [0.0 if kept else _error(f) + _error(g) for g, kept in zip(functions, same, strict=True)]
    )
    bias = np.array([np.asarray(g.integral) - np.asarray(f.integral) for g in functions])
    error = error.reshape(-1, *(1,) * (bias.ndim - 1))
    low, high = np.maximum(np.abs(bias) - error, 0.0), np.abs(bias) + error
    return bias, np.stack([low, high], axis=-1) ** 2


def _error(g: Integrand) -> float:
    return integral_accuracy(g)[1]


def _summed(mse: Array, mse_ci: Array, channels: int) -> tuple[Array, Array]:
    """Both summed over channels: (W, N) and (W, N, 2)."""
    return (mse.sum(axis=2), mse_ci.sum(axis=2)) if channels else (mse, mse_ci)


def _best(widths: Array, mse: Array, ci: Array) -> tuple[Array, Array]:
    """Width of the least mse for each n, and the least and largest of those that may have it."""
    best = mse.argmin(axis=0)
    top = ci[best, np.arange(mse.shape[1]), 1]
    candidates = [widths[ci[:, i, 0] <= top[i]] for i in range(mse.shape[1])]
    return widths[best], np.array([[c.min(), c.max()] for c in candidates])
