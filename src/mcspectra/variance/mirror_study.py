"""The study of mirroring: convergence of an estimator, mirrored or not, homogenised or not.

The talk to [Singh2019]_ shows six convergence plots: original, mirror-random and mirror-uniform,
each with and without a shift of the samples. Homogenisation makes a stationary set of any other,
and its wrap-around a discontinuity of any integrand that is not periodic; mirroring makes the
integrand continuous across the faces.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.errors import NoClosedForm, ParameterError
from mcspectra.core.results import dataset
from mcspectra.core.streams import RngLike
from mcspectra.estimators import MIRRORINGS, AbstractEstimator, Mirrored, as_estimator
from mcspectra.integrands import Integrand
from mcspectra.samplers import Sampler, Shift, as_sampler
from mcspectra.variance.convergence import convergence
from mcspectra.variance.exact import exact_variance

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["mirror_study"]

_ORIGINAL = "original"
_KEPT = (
    "variance",
    "variance_ci",
    "mean",
    "mean_se",
    "rate",
    "rate_ci",
)


def mirror_study(
    estimator: AbstractEstimator | Integrand | str,
    sampler: Sampler | str,
    counts: Sequence[int],
    *,
    mirrorings: Sequence[str] = (_ORIGINAL, *MIRRORINGS),
    exact: bool = False,
    realizations: int = 1000,
    rng: RngLike = 0,
    workers: int | None = None,
) -> xr.Dataset:
    """Measure variances and rates with and without mirroring and homogenisation.

    Parameters
    ----------
    estimator, sampler, counts
        As for `mcspectra.convergence`; the sampler without a shift at its end. n counts evaluations
        of the integrand, so that variances at one n are at equal cost.
    mirrorings
        Which of ``"original"``, ``"integrand"``, ``"random"``, ``"uniform"``
        (`mcspectra.Mirrored`); the slides' six plots leave out ``"integrand"``.
    exact
        Also return exact variances: fast in 1-D, up to minutes a count for shifted sets in 2-D.
    realizations, rng, workers
        As for `mcspectra.convergence`; all curves share random numbers.

    Returns
    -------
    xarray.Dataset
        ``variance``, ``variance_ci``, ``mean``, ``mean_se``, and with `exact` ``exact_variance`` (NaN
        where it is not known), on the dims mirroring, homogenized (False, True: with ``shift``) and
        n; ``rate`` and ``rate_ci`` on the first two; and the dim channel where f has several.

    Raises
    ------
    CountError, ParameterError
        A sampler cannot do a count (``"uniform"`` needs multiples of 2^d), a mirroring is unknown or
        listed twice, the sampler ends with a shift already, `exact` is neither True nor False.

    Examples
    --------
    >>> import mcspectra as mcs
    >>> study = mcs.mirror_study("linear", mcs.sampler("jittered", dims=1), [16, 512], rng=1)
    >>> [round(float(r), 1) for r in study["rate"].sel(mirroring="original")]
    [-3.0, -2.0]
    >>> [round(float(r), 1) for r in study["rate"].sel(mirroring="integrand")]
    [-3.0, -3.0]
    """
    if not isinstance(exact, bool):
        raise ParameterError(f"exact is {exact!r}; give True or False.")
    plain = as_estimator(estimator, getattr(sampler, "dims", None))
    source = as_sampler(sampler, plain.dims)
    names = _check_mirrorings(mirrorings)
    samplers = _both(source)
    estimators = [plain if name == _ORIGINAL else Mirrored(plain, name) for name in names]
    measured = convergence(
        estimators, samplers, counts, realizations=realizations, rng=rng, workers=workers
    ).rename(estimator="mirroring", sampler="homogenized")
    variables = {name: (_dims(measured[name]), measured[name].values) for name in _KEPT}
    if exact:
        grid = [[[_exact(e, s, int(n)) for n in counts] for s in samplers] for e in estimators]
        variables["exact_variance"] = (variables["variance"][0], np.array(grid))
    coords: dict[str, Any] = {name: measured[name] for name in ("n", "bound")}
    return dataset(
        variables,
        {**coords, "mirroring": names, "homogenized": [False, True]},
        estimator=plain.spec,
        sampler=source.spec,
        **{key: measured.attrs[key] for key in ("realizations", "stream_key")},
        seed=rng if isinstance(rng, int) else None,
    )


def _dims(array: xr.DataArray) -> tuple[str, ...]:
    return tuple(map(str, array.dims))


def _check_mirrorings(given: Any) -> list[str]:
    allowed = (_ORIGINAL, *MIRRORINGS)
    names = list(given) if isinstance(given, list | tuple) else []
    if (
        not names
        or len(set(map(str, names))) < len(names)
        or not set(map(str, names)) <= {*allowed}
    ):
        raise ParameterError(
            f"mirrorings is {given!r:.80}; give a list of some of {', '.join(allowed)}, each once."
        )
    return names


def _both(sampler: Sampler) -> list[Sampler]:
    """The sampler by itself and with a shift after it."""
    if sampler.spec.endswith("| shift"):
        raise ParameterError(
            f"{sampler.spec} is homogenised already; give it without the shift at its end."
        )
    return [sampler, sampler.then(Shift())]


def _exact(estimator: AbstractEstimator, sampler: Sampler, n: int) -> Array | float:
    try:
        return exact_variance(estimator, sampler, n)  # type: ignore[no-any-return]
    except NoClosedForm:
        return np.full(estimator.channels, np.nan) if estimator.channels else np.nan
