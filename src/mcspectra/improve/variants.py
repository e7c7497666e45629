"""Convergence of set-ups with smoothed edges or mirroring, all with the same random numbers.

Smoothing and mirroring are explained in docs/theory.md, "Mirroring and smoothing".
The bias of smoothing does not fall with n.
Therefore the width of smoothed edges with the least mean squared error depends on n.
The talk on [Singh2019]_ shows six convergence plots, with and without a shift of the samples.
The plots show three variants of the estimator: original, mirror-random and mirror-uniform.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, final

import numpy as np

from mcspectra.core.checks import as_real
from mcspectra.core.errors import NoClosedForm, ParameterError
from mcspectra.core.results import coordinate, dataset
from mcspectra.core.streams import RngLike
from mcspectra.densities import Density
from mcspectra.estimators import MIRRORINGS, AbstractEstimator, Estimator, Mirrored, as_subject
from mcspectra.integrands import Integrand, as_integrand, integral_accuracy
from mcspectra.integrands.smoothing import BoxSmoothed, smoothed
from mcspectra.measure.converge import convergence
from mcspectra.measure.sums import Variables
from mcspectra.prediction.exact import exact_variance
from mcspectra.samplers import Sampler, Shift

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["mirror_study", "smoothing_scan"]

_ORIGINAL = "original"


@final
@dataclass(frozen=True)
class SmoothingSettings:
    """Settings of scans over widths of smoothed edges."""

    # Maximum number of widths in one scan.
    # With 64 points and the default 1000 realizations, 256 widths take 1.6e7 evaluations.
    most_widths: int = 256


_SETTINGS = SmoothingSettings()


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
        The integrand f, or a spec of an integrand.
    sampler, counts
        A sampler, and one number of points n or several in ascending order.
        A rate needs at least two numbers of points.
    widths
        Widths δ in ascending order; see `mcspectra.smoothed`. The width 0 means f itself.
    density
        Importance density; see `mcspectra.Estimator`.
    method
        Same as in `mcspectra.smoothed`.
    realizations, rng, workers
        Same as in `mcspectra.convergence`. All widths use the same random numbers.

    Returns
    -------
    xarray.Dataset
        A dataset. ``variance(width, n)`` with ``variance_ci`` is the variance.
        ``rate(width)`` with ``rate_ci`` is the rate of this variance.
        ``smoothing_bias(width)`` is the change of the integral.
        ``bias_squared(width)`` is the square of the change of the integral.
        The interval ``bias_squared_ci`` is computed from the errors of both integrals.
        ``mse(width, n)`` with ``mse_ci`` is the mean squared error, bias² + variance.
        ``best_width(n)`` is the width with the least mse.
        ``best_width_range(n, bound)`` is the range of widths that may be best within the intervals.
        If f has several channels, there is a dim channel. ``best_width`` minimizes the sum of mse.

    Raises
    ------
    CountError, ParameterError
        If the sampler cannot draw one of the counts, or if dims disagree.
        If widths are not ascending, or if a width is impossible.

    Examples
    --------
    >>> import mcspectra as mcs
    >>> d = mcs.improve.smoothing_scan("disk(center=0.47)", "jittered", 256, [0, 0.05, 0.2], rng=1)
    >>> float(d["best_width"][0])
    0.05
    """
    f = as_integrand(integrand, getattr(sampler, "dims", None))
    given: Any = widths
    if not isinstance(given, Sequence | np.ndarray) or isinstance(given, str):
        raise ParameterError(f"widths is {widths!r:.80}; give a list of ascending widths.")
    if len(widths) > _SETTINGS.most_widths:
        raise ParameterError(
            f"widths has {len(widths)} values; give {_SETTINGS.most_widths} at most."
        )
    places = [as_real(f"widths[{i}]", w, least=0.0) for i, w in enumerate(widths)]
    if not places or sorted(set(places)) != places:
        raise ParameterError(f"widths is {widths!r:.80}; give one or more, ascending.")
    functions = [smoothed(f, w, method=method) if w else f for w in places]
    measured = convergence(
        [Estimator(g, density) for g in functions],
        sampler,
        counts if isinstance(counts, Sequence | np.ndarray) else [counts],
        realizations=realizations,
        rng=rng,
        workers=workers,
    ).rename(estimator="width")

    # Compute the bias ∫ f_δ − ∫ f of each width δ, (W[, channels]).
    # The errors of the two integrals give an interval of the squared bias.
    # Smoothing by means over boxes does not change the integral of f
    kept = [g is f or isinstance(g, BoxSmoothed) for g in functions]
    pairs = list(zip(functions, kept, strict=True))
    accuracy = [0.0 if k else integral_accuracy(f)[1] + integral_accuracy(g)[1] for g, k in pairs]
    none = np.zeros(f.channels or ())
    bias = np.array([none if k else np.asarray(g.integral) - f.integral for g, k in pairs])
    error = np.array(accuracy)
    error = error.reshape(-1, *(1,) * (bias.ndim - 1))
    low, high = np.maximum(np.abs(bias) - error, 0.0), np.abs(bias) + error
    square_ci = np.stack([low, high], axis=-1) ** 2

    # For each n, find the width with the least error.
    # Also find all widths whose error may be the least error, because the error intervals overlap
    mse = measured["variance"].values + np.expand_dims(bias**2, 1)
    mse_ci = measured["variance_ci"].values + np.expand_dims(square_ci, 1)
    total, ci = (mse.sum(axis=2), mse_ci.sum(axis=2)) if f.channels else (mse, mse_ci)
    best, columns, each = total.argmin(axis=0), range(total.shape[1]), np.array(places)
    candidates = [each[ci[:, i, 0] <= ci[best[i], i, 1]] for i in columns]
    axes = ("width", "channel")[: bias.ndim]
    found = _of(measured, "variance", "variance_ci", "rate", "rate_ci")
    dims, _ = found["variance"]
    return dataset(
        {
            **found,
            "smoothing_bias": (axes, bias),
            "bias_squared": (axes, bias**2),
            "bias_squared_ci": ((*axes, "bound"), square_ci),
            "mse": (dims, mse),
            "mse_ci": ((*dims, "bound"), mse_ci),
            "best_width": (("n",), each[best]),
            "best_width_range": (
                ("n", "bound"),
                np.array([[c.min(), c.max()] for c in candidates]),
            ),
        },
        {
            "width": coordinate("width", places, "width of smoothed edges"),
            "n": measured["n"],
            "bound": measured["bound"],
        },
        integrand=f.spec,
        method=method,
        **{key: measured.attrs[key] for key in ("sampler", "realizations", "stream_key")},
        seed=rng if isinstance(rng, int) else None,
    )


def mirror_study(
    estimator: Any,
    sampler: Sampler | str,
    counts: Sequence[int],
    *,
    dims: int | None = None,
    mirrorings: Sequence[str] = (_ORIGINAL, *MIRRORINGS),
    exact: bool = False,
    realizations: int = 1000,
    rng: RngLike = 0,
    max_evaluations: int | None = None,
    workers: int | None = None,
) -> xr.Dataset:
    """Measure variances and rates with and without mirroring and homogenization.

    Parameters
    ----------
    estimator, sampler, counts
        Same as in `mcspectra.convergence`. The sampler must not end with a shift.
        The number n counts evaluations of the integrand, so the same n means the same cost.
    dims
        Number of dims; needed if the estimator is a function or a spec without dims.
        The default is the sampler's number of dims, unless the sampler is given as a spec.
    mirrorings
        Some of ``"original"``, ``"integrand"``, ``"random"``, ``"uniform"``; see `Mirrored`.
        The mode ``"integrand"`` is not in the six plots of mirroring on the paper's slides.
    exact
        Whether exact variances are also returned. Exact variances are fast in 1-D.
        In 2-D, exact variances can take minutes for each count of a shifted set.
    realizations, rng
        Same as in `mcspectra.convergence`. All curves use the same random numbers.
    max_evaluations, workers
        Same as in `mcspectra.convergence`.

    Returns
    -------
    xarray.Dataset
        A dataset with ``variance``, ``variance_ci``, ``mean`` and ``mean_se``.
        If `exact` is true, it also has ``exact_variance``, with NaN for unknown values.
        The dims are mirroring, homogenized (True with ``shift``) and n.
        ``rate`` and ``rate_ci`` have the dims mirroring and homogenized only.
        A dim channel is added if f has several channels.

    Raises
    ------
    CountError, ParameterError
        If a sampler cannot draw one of the counts (``"uniform"`` needs multiples of 2^d).
        If a mirroring is unknown or listed twice, or if the sampler already ends with a shift.
        If `exact` is neither True nor False.

    Examples
    --------
    >>> import mcspectra as mcs
    >>> linear = mcs.sampler("jittered", dims=1)
    >>> study = mcs.improve.mirror_study("linear", linear, [16, 512], rng=1)
    >>> [round(float(r), 1) for r in study["rate"].sel(mirroring="original")]
    [-3.0, -2.0]
    >>> [round(float(r), 1) for r in study["rate"].sel(mirroring="integrand")]
    [-3.0, -3.0]
    """
    if not isinstance(exact, bool):
        raise ParameterError(f"exact is {exact!r}; give True or False.")
    subject = as_subject(estimator, sampler, dims=dims)
    plain, source = subject.estimator, subject.sampler
    allowed = (_ORIGINAL, *MIRRORINGS)
    names = list(mirrorings) if isinstance(mirrorings, list | tuple) else []
    texts = set(map(str, names))
    if not names or len(texts) < len(names) or not texts <= {*allowed}:
        raise ParameterError(
            f"mirrorings is {mirrorings!r:.80}; give a list of some of {', '.join(allowed)}, each "
            "once."
        )
    if source.spec.endswith("| shift"):
        raise ParameterError(
            f"{source.spec} is already homogenized; give it without the shift at its end."
        )
    samplers = [source, source.then(Shift())]
    estimators = [plain if name == _ORIGINAL else Mirrored(plain, name) for name in names]
    measured = convergence(
        estimators,
        samplers,
        counts,
        realizations=realizations,
        rng=rng,
        max_evaluations=max_evaluations,
        workers=workers,
    ).rename(estimator="mirroring", sampler="homogenized")
    variables = _of(measured, "variance", "variance_ci", "mean", "mean_se", "rate", "rate_ci")
    if exact:

        def known(e: AbstractEstimator, s: Sampler, n: int) -> Any:
            try:
                return exact_variance(e, s, n)
            except NoClosedForm:
                return np.full(plain.channels, np.nan) if plain.channels else np.nan

        grid = [[[known(e, s, int(n)) for n in counts] for s in samplers] for e in estimators]
        variables["exact_variance"] = (variables["variance"][0], np.array(grid))
    return dataset(
        variables,
        {
            "n": measured["n"],
            "bound": measured["bound"],
            "mirroring": names,
            "homogenized": [False, True],
        },
        estimator=plain.spec,
        sampler=source.spec,
        **{key: measured.attrs[key] for key in ("realizations", "stream_key")},
        seed=rng if isinstance(rng, int) else None,
    )


def _of(measured: xr.Dataset, *names: str) -> Variables:
    """Return the named variables of a dataset in the form that another dataset accepts."""
    return {name: (tuple(map(str, measured[name].dims)), measured[name].values) for name in names}
