"""Every route to the variance of one estimator, in one table.

* exact: quadrature over strata or levels, `exact_variance`; no spectrum, no sampling.
* pairs: pair correlation, `variance_from_pair_correlation`; no spectrum either.
* covariance: Σ_m Σ_l conj(f_m) f_l C_ml with C_ml in closed form; no sampling.
* homogenized: Σ_{m≠0} |f_m|² ⟨|S_m|²⟩, for uniform points that are the same after any translation.
* spectral: dc + power + cross from realisations, `variance_terms`.
* measured: the variance of the estimates over the same realisations.

The three spectral routes see the frequencies within a half width only; `energy_share` says how much of
∫f² these hold. Where it is 1, all routes lead to the same number.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from mcspectra.core.checks import Array, as_integer
from mcspectra.core.errors import NoClosedForm, ParameterError
from mcspectra.core.parallel import MAX_REALIZATIONS
from mcspectra.core.results import dataset
from mcspectra.core.streams import RngLike, Stream
from mcspectra.estimators import AbstractEstimator, Estimator, as_estimator
from mcspectra.estimators.moments import CONFIDENCE_Z
from mcspectra.integrands import Integrand
from mcspectra.samplers import Sampler, as_sampler
from mcspectra.spectra.bases import fitting_basis
from mcspectra.spectra.closed_forms import closed_form_covariance, closed_form_power
from mcspectra.spectra.transforms import FrequencyGrid
from mcspectra.variance._squares import mean_square
from mcspectra.variance.exact import exact_variance
from mcspectra.variance.pair_route import variance_from_pair_correlation
from mcspectra.variance.terms import variance_terms

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["ROUTES", "variance_routes"]

ROUTES = ("exact", "pairs", "covariance", "homogenized", "spectral", "measured")
"""Names of the routes, in the order of the table."""

_MOST_FREQUENCIES = 625  # of the covariance route: their pairs are summed
_PAIRS = 2**16  # at once


def variance_routes(
    estimator: AbstractEstimator | Integrand | str,
    sampler: Sampler | str,
    n: int,
    *,
    half_width: int = 16,
    realizations: int = 1000,
    rng: RngLike = 0,
    workers: int | None = None,
) -> xr.Dataset:
    """Return the variance of an estimator by every route there is, side by side.

    Parameters
    ----------
    estimator, sampler, n
        As for `variance_terms`.
    half_width
        Of the spectral routes: frequencies m in {−half_width … half_width}^d. The covariance route,
        which sums pairs of them, takes 625 in all at most.
    realizations
        Of the routes that sample, at least 4, which standard errors take.
    rng
        Seed (SPEC 7); pairs are counted in other realisations than those that are measured.
    workers
        Threads; all processors by default.

    Returns
    -------
    xarray.Dataset
        On dim route: ``route_variance``, NaN where there is no such route; ``route_variance_ci`` on dim
        bound, its 95 % interval, of no width where nothing was sampled; ``energy_share``, the part of ∫f²
        within the half width, 1 for routes without one, NaN for techniques without a common f. The
        coordinate ``source`` says how each was found, or why not. A dim channel where f has several.

    Raises
    ------
    ParameterError, CountError
        A value is out of range, dims disagree, or the sampler cannot do n.

    Examples
    --------
    >>> import mcspectra as mcs
    >>> estimator = mcs.Estimator("cosine(frequency=3)", dims=1)
    >>> table = mcs.variance_routes(estimator, "jittered | shift", 8, realizations=400)
    >>> known = table["route_variance"].sel(route=["exact", "covariance", "homogenized"])
    >>> known.values.round(6)
    array([0.024063, 0.024063, 0.024063])
    """
    estimator = as_estimator(estimator, getattr(sampler, "dims", None))
    source = as_sampler(sampler, estimator.dims)
    n = source.check_count(n)
    estimator.check_sampler(source, n)
    realizations = as_integer("realizations", realizations, least=4, most=MAX_REALIZATIONS)
    FrequencyGrid(estimator.domain_dims, half_width)  # refuses what is too large before any work
    key = Stream.from_rng(rng).key
    routes = _Routes(estimator, source, n, half_width, realizations, key, workers)
    found = [_attempt(getattr(routes, name)) for name in ROUTES]
    channels = ("channel",) if estimator.channels else ()
    shape = (len(ROUTES), *([estimator.channels] if estimator.channels else []))
    value, low, high, share = (
        np.stack([np.broadcast_to(np.asarray(f[i], float), shape[1:]) for f in found])
        for i in range(4)
    )
    return dataset(
        {
            "route_variance": (("route", *channels), value),
            "route_variance_ci": (("route", *channels, "bound"), np.stack([low, high], axis=-1)),
            "energy_share": (("route", *channels), share),
        },
        {
            "route": list(ROUTES),
            "source": ("route", [f[4] for f in found]),
            "bound": ["low", "high"],
        },
        estimator=estimator.spec,
        sampler=source.spec,
        n=n,
        half_width=half_width,
        realizations=realizations,
        seed=rng if isinstance(rng, int) else None,
    )


_Found = tuple[Any, Any, Any, Any, str]  # value, low, high, energy share, source


def _attempt(route: Callable[[], _Found]) -> _Found:
    """What a route leads to, or NaN and the reason why it leads nowhere."""
    try:
        return route()
    except (NoClosedForm, ParameterError) as error:  # arguments were checked before
        return (np.nan, np.nan, np.nan, np.nan, str(error))


@dataclass(frozen=True)
class _Routes:
    """The routes of one estimator, sampler and n; each a method of the name in `ROUTES`."""

    estimator: AbstractEstimator
    sampler: Sampler
    n: int
    half_width: int
    realizations: int
    key: int
    workers: int | None

    def exact(self) -> _Found:
        return _certain(
            exact_variance(self.estimator, self.sampler, self.n),
            1.0,
            "quadrature over strata or levels",
        )

    def pairs(self) -> _Found:
        found = variance_from_pair_correlation(
            self.estimator,
            self.sampler,
            self.n,
            realizations=self.realizations,
            rng=np.random.SeedSequence([self.key, 1]),
            workers=self.workers,
        )
        value, se = found["variance"].to_numpy(), found["variance_se"].to_numpy()
        return _normal(value, se, 1.0, found.attrs["method"])

    def covariance(self) -> _Found:
        plain = self._plain()
        m = _frequencies(plain.integrand.dims, self._matrix_width())
        f = plain.integrand.fourier(m).reshape(len(m), -1)
        total = np.zeros(f.shape[1])
        rows = max(1, _PAIRS // len(m))
        for i in range(0, len(m), rows):
            c = closed_form_covariance(
                self.sampler, self.n, m[i : i + rows, None], m[None], density=plain.density
            )
            total += np.einsum("mc,ml,lc->c", np.conj(f[i : i + rows]), c, f).real
        share = self._share(np.square(np.abs(f)).sum(axis=0))
        return _certain(self._of_channels(total), share, "C_ml in closed form")

    def homogenized(self) -> _Found:
        plain = self._plain()
        stationary = fitting_basis(self.sampler, self.half_width) == "fourier"
        if plain.density is not None or not (stationary or self.sampler.name == "random"):
            raise NoClosedForm(
                "The homogenised formula holds for uniform points that are the same after any "
                f"translation, not for {plain.spec} with {self.sampler.spec}; add shift."
            )
        m = _frequencies(plain.integrand.dims, self.half_width)
        f = np.abs(plain.integrand.fourier(m).reshape(len(m), -1)) ** 2
        share = self._share(f.sum(axis=0))
        try:
            power = closed_form_power(self.sampler, self.n, m)
        except NoClosedForm:
            terms = self._terms
            value, se = terms["power_term"].to_numpy(), terms["power_term_se"].to_numpy()
            return _normal(value, se, share, "power from realisations")
        power = np.where((m == 0).all(axis=1), 0.0, power)
        return _certain(self._of_channels(power @ f), share, "power in closed form")

    def spectral(self) -> _Found:
        terms = self._terms
        low, high = np.moveaxis(terms["predicted_variance_ci"].to_numpy(), -1, 0)
        share: Any = np.nan
        if self.estimator.domain_integrand is not None:
            power = np.abs(self.estimator.domain_integrand.fourier_grid(self.half_width)) ** 2
            share = self._share(power.reshape(-1, max(1, self.estimator.channels)).sum(axis=0))
        source = f"{terms.attrs['space']} view, {terms.attrs['basis']}"
        return terms["predicted_variance"].to_numpy(), low, high, share, source

    def measured(self) -> _Found:
        low, high = np.moveaxis(self._terms["measured_variance_ci"].to_numpy(), -1, 0)
        source = f"{self.realizations} realisations"
        return self._terms["measured_variance"].to_numpy(), low, high, 1.0, source

    @cached_property
    def _terms(self) -> xr.Dataset:
        whole = self.estimator.domain_integrand is not None and not self.estimator.infinite_weights
        return variance_terms(
            self.estimator,
            self.sampler,
            self.n,
            half_width=self.half_width,
            realizations=self.realizations,
            rng=np.random.SeedSequence([self.key, 0]),
            space="domain" if whole else "primary",
            workers=self.workers,
        )

    def _plain(self) -> Estimator:
        if not isinstance(self.estimator, Estimator):
            raise NoClosedForm(
                f"Closed forms of spectra are known for one technique, not for {self.estimator.spec}."
            )
        return self.estimator

    def _matrix_width(self) -> int:
        side = int(_MOST_FREQUENCIES ** (1.0 / self.estimator.domain_dims) + 1e-9)
        if side < 3:
            raise NoClosedForm(
                f"In {self.estimator.domain_dims} dims the pairs of frequencies are too many to sum."
            )
        return min(self.half_width, (side - 1) // 2)

    def _share(self, within: Array) -> Any:
        """Part of ∫f² that Σ|f_m|² = `within` is."""
        assert self.estimator.domain_integrand is not None
        try:
            whole = mean_square(self.estimator.domain_integrand)
        except ParameterError:  # too many dims for a quadrature
            return np.nan
        return self._of_channels(np.divide(within, whole, out=np.ones(len(whole)), where=whole > 0))

    def _of_channels(self, values: Array) -> Any:
        return values if self.estimator.channels else float(values[0])


def _frequencies(dims: int, half_width: int) -> Array:
    """All m of a grid: (M, dims)."""
    axis = np.arange(-half_width, half_width + 1)
    return np.stack(np.meshgrid(*[axis] * dims, indexing="ij"), axis=-1).reshape(-1, dims)


def _certain(value: Any, share: Any, source: str) -> _Found:
    return value, value, value, share, source


def _normal(value: Any, se: Any, share: Any, source: str) -> _Found:
    half = CONFIDENCE_Z * se
    return value, value - half, value + half, share, source
