"""Every route to the variance of one estimator, in one table (docs/spectra.md).

The three spectral routes see the frequencies within a half width only; `energy_share` says how much
of ∫f² these hold. Where it is 1, all routes lead to the same number.

The route by pairs (docs/theory.md, "Pair correlation"): random and jittered points have pairs of known
density; those of a stationary set are counted in full, not by distance only, and add up A(x_i − x_k)
with the autocorrelation A of the integrand on the torus, tabulated and linear between the entries.
Averaging A over directions, so that g(|h|) would do, is exact for isotropic sets only: measured at
n = 16, it gives 1.7 to 3.7 times the variance of smooth integrands for latin-hypercube with shift.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any, final

import numpy as np
from msgspec import Meta

from mcspectra.core.analysis import Counted, MergeTree, Need, Reduction, Steps, Subject
from mcspectra.core.checks import Array, as_integer
from mcspectra.core.errors import MEASURE_IT, Function, NoClosedForm, ParameterError
from mcspectra.core.memory import memory_of
from mcspectra.core.options import COUNT, HALF_WIDTH
from mcspectra.core.parallel import MAX_REALIZATIONS, available_workers, map_in_order
from mcspectra.core.records import JOIN, MeanSums, merged
from mcspectra.core.results import dataset
from mcspectra.core.streams import RngLike, Stream
from mcspectra.estimators import AbstractEstimator, Estimator, as_subject
from mcspectra.estimators.moments import CONFIDENCE_Z
from mcspectra.integrands import Integrand
from mcspectra.samplers import Sampler
from mcspectra.samplers.base import Structure
from mcspectra.spectra.bases import fitting_basis, parts_of
from mcspectra.spectra.closed_forms import closed_form_covariance, closed_form_power
from mcspectra.spectra.transforms import FrequencyGrid
from mcspectra.variance._kernels import pair_sum_1d, pair_sum_2d
from mcspectra.variance.doors import answer
from mcspectra.variance.exact import exact_variance
from mcspectra.variance.ordered import weighted_sum
from mcspectra.variance.quadrature import (
    grid,
    mesh,
    orders_of,
    square_integral,
    stratum_moments,
    values_at,
)
from mcspectra.variance.terms import Terms

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["ROUTES", "Routes", "variance_from_pair_correlation", "variance_routes"]

ROUTES = ("exact", "pairs", "covariance", "homogenized", "spectral", "measured")
"""Names of the routes, in the order of the table."""

_APART = ROUTES[:4]  # routes that need no realisations, or other ones than those measured
_MOST_FREQUENCIES = 625  # of the covariance route: their pairs are summed
_PAIRS = 2**16  # at once
_GRID = {1: 2**15, 2: 2**10}  # points of an axis where the autocorrelation is sampled
_MOST_POINTS = 2**17
_TOLERANCE = 1e-6
_AGREE = 1e-5  # relative error of exact variances in the table
_ROUNDING = 4e-15
_MOVES = frozenset({"shift", "strata-shift", "shuffle"})  # keep the differences of points
_SAMPLED = "power from realisations"


@final
class Routes(Counted, frozen=True, kw_only=True):
    """The variance by every route there is, side by side."""

    function = "variance_routes"
    variables = ("route_variance", "route_variance_ci", "energy_share")

    n: Annotated[int, COUNT]
    half_width: Annotated[int, HALF_WIDTH] = 16
    realizations: Annotated[
        int,
        Meta(
            ge=4,
            le=MAX_REALIZATIONS,
            description="Realisations of the routes that sample.",
            extra={"flag": "-m", "metavar": "R"},
        ),
    ] = 1000

    def need(self, subject: Subject) -> Need:
        """The frequencies fit."""
        estimator = subject.estimator
        estimator.check_sampler(subject.sampler, self.n)
        size = FrequencyGrid(estimator.domain_dims, self.half_width).size
        evaluations = sum(estimator.counts)
        pairs = 0.1 * evaluations * self.n**2
        return Need(
            cost=self.realizations * (evaluations * self.n + size + pairs),
            memory=memory_of(self.n, estimator.dims, evaluations, size),
        )

    def reduction(self, subject: Subject, stream: Stream) -> Steps:
        """Each route that stands apart is a block; the terms are of the realisations measured."""
        estimator, cost, n = subject.estimator, self.need(subject).cost, self.n
        whole = estimator.domain_integrand is not None and not estimator.infinite_weights
        asked = Terms(
            n=self.n,
            half_width=self.half_width,
            realizations=self.realizations,
            space="domain" if whole else "primary",
        )
        own = Stream.from_rng(np.random.SeedSequence([stream.key, 0]))
        terms = asked.reduction(subject, own)

        def of_route(index: int) -> _Rows:
            """What a route leads to, or NaN and the reason why it leads nowhere."""
            try:
                match _APART[index]:
                    case "exact":
                        value = exact_variance(estimator, subject.sampler, n, tolerance=_AGREE)
                        return row(value, 0.0, 1.0, "quadrature over strata or levels")
                    case "pairs":
                        found = variance_from_pair_correlation(
                            estimator,
                            subject.sampler,
                            n,
                            realizations=self.realizations,
                            rng=np.random.SeedSequence([stream.key, 1]),
                            workers=1,
                        )
                        value, se = found["variance"].to_numpy(), found["variance_se"].to_numpy()
                        return row(value, CONFIDENCE_Z * se, 1.0, found.attrs["method"])
                    case name:
                        value, within, source = self._of_spectra(name, subject)
                        return row(value, 0.0, share_of(within), source)
            except (NoClosedForm, ParameterError) as error:  # arguments were checked before
                return row(np.nan, np.nan, np.nan, str(error))

        def row(value: Any, half: Any, share: Any, source: str) -> _Rows:
            """A row of the table, with an interval of so much on either side."""
            numbers = np.empty((1, 4, max(1, estimator.channels)))
            for place, number in enumerate((value, value - half, value + half, share)):
                numbers[0, place] = number
            return _Rows(numbers, np.array([source]))

        def share_of(within: Array) -> Any:
            """Part of ∫f² that Σ|f_m|² = `within` is."""
            try:
                whole, _ = square_integral(estimator.domain_integrand)
            except ParameterError:  # too many dims for a quadrature
                return np.nan
            return np.divide(within, whole, out=np.ones(len(whole)), where=whole > 0)

        apart = Reduction(
            kind=_Rows,
            block=of_route,
            blocks=len(_APART),
            cost=max(cost - terms.cost, 1.0),
            key="apart",
        )
        rows, total = yield [apart, replace(terms, key="terms")]
        assert terms.result is not None
        found = terms.result(total)

        # The power term stands in for a spectrum that is not known in closed form
        if rows.source[-1] == _SAMPLED:
            value, half = (found[name].to_numpy() for name in ("power_term", "power_term_se"))
            sampled = row(value, CONFIDENCE_Z * half, rows.numbers[-1, 3], _SAMPLED)
            rows = merged(_Rows(rows.numbers[:-1], rows.source[:-1]), sampled)
        share: Any = np.nan
        if estimator.domain_integrand is not None:
            power = np.abs(estimator.domain_integrand.fourier_grid(self.half_width)) ** 2
            share = share_of(power.reshape(-1, max(1, estimator.channels)).sum(axis=0))
        for name, part, source in (
            ("predicted_variance", share, "{space} view, {basis}".format(**found.attrs)),
            ("measured_variance", 1.0, f"{self.realizations} realisations"),
        ):
            last = row(found[name].to_numpy(), 0.0, part, source)
            last.numbers[0, 1:3] = np.moveaxis(found[f"{name}_ci"].to_numpy(), -1, 0).reshape(2, -1)
            rows = merged(rows, last)
        return dataset(
            {
                "route_variance": (("route", "channel"), rows.numbers[:, 0]),
                "route_variance_ci": (
                    ("route", "channel", "bound"),
                    np.moveaxis(rows.numbers[:, 1:3], 1, 2),
                ),
                "energy_share": (("route", "channel"), rows.numbers[:, 3]),
            },
            {
                "route": list(ROUTES),
                "source": ("route", [str(text) for text in rows.source]),
                "bound": ["low", "high"],
            },
            drop=() if estimator.channels else ("channel",),
            estimator=estimator.spec,
            sampler=subject.sampler.spec,
            n=n,
            half_width=self.half_width,
            realizations=self.realizations,
            note=found.attrs.get("note"),
        )

    def _of_spectra(self, name: str, subject: Subject) -> tuple[Any, Array, str]:
        """The variance by closed forms, NaN where the power is not known, Σ_m |f_m|² and the source."""
        plain, sampler, dims = subject.estimator, subject.sampler, subject.estimator.domain_dims
        if not isinstance(plain, Estimator):
            raise NoClosedForm(
                f"Closed forms of spectra are known for one technique, not for {plain.spec}."
            )
        width = self.half_width
        if name == "covariance":
            side = int(_MOST_FREQUENCIES ** (1.0 / dims) + 1e-9)
            if side < 3:
                raise NoClosedForm(f"In {dims} dims the pairs of frequencies are too many to sum.")
            width = min(width, (side - 1) // 2)
        else:
            stationary = fitting_basis(sampler, width) == "fourier"
            if plain.density is not None or not (stationary or sampler.name == "random"):
                raise NoClosedForm(
                    "The homogenised formula holds for uniform points that are the same after any "
                    f"translation, not for {plain.spec} with {sampler.spec}; add shift."
                )
        m = grid(np.arange(-width, width + 1), plain.integrand.dims)
        f = plain.integrand.fourier(m).reshape(len(m), -1)
        power = np.abs(f) ** 2
        if name == "covariance":
            # Σ_m Σ_l conj(f_m) f_l C_ml
            total = np.zeros(f.shape[1])
            rows = max(1, _PAIRS // len(m))
            for i in range(0, len(m), rows):
                some = m[i : i + rows, None]
                c = closed_form_covariance(sampler, self.n, some, m[None], density=plain.density)
                total += np.einsum("mc,ml,lc->c", np.conj(f[i : i + rows]), c, f).real
            return total, power.sum(axis=0), "C_ml in closed form"
        # Σ_{m≠0} |f_m|² ⟨|S_m|²⟩
        try:
            known = closed_form_power(sampler, self.n, m)
        except NoClosedForm:
            return np.nan, power.sum(axis=0), _SAMPLED
        known = np.where((m == 0).all(axis=1), 0.0, known)
        return weighted_sum(known, power), power.sum(axis=0), "power in closed form"


def variance_routes(
    estimator: AbstractEstimator | Integrand | str,
    sampler: Sampler | str,
    n: int,
    *,
    half_width: int = 16,
    realizations: int = 1000,
    rng: RngLike = 0,
    max_evaluations: int | None = None,
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
    max_evaluations
        Most evaluations of the integrand: what takes more is refused, where that is known before it starts.

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
    return answer(Routes, locals())


@dataclass(frozen=True)
class _Rows:
    """Rows of the table."""

    numbers: JOIN  # variance, its bounds and share of the energy: (routes, 4, channels or 1)
    source: JOIN  # texts


def variance_from_pair_correlation(
    estimator: AbstractEstimator | Integrand | str,
    sampler: Sampler | str,
    n: int,
    *,
    realizations: int = 1000,
    rng: RngLike = 0,
    workers: int | None = None,
) -> xr.Dataset:
    """Return the variance of an estimate, from the pairs of points only.

    Parameters
    ----------
    estimator, n
        Any estimator, and the number of points.
    sampler
        ``random`` and ``jittered``, whose pairs are known exactly; else a stationary set in 1-D or
        2-D, by shift or by itself, whose pairs are counted.
    realizations
        Number of sets of which the pairs are counted; 2 or more for a standard error.
    rng
        Seed (SPEC 7).
    workers
        Threads; all processors by default.

    Returns
    -------
    xarray.Dataset
        ``variance``, infinite where ∫g² diverges, and ``variance_se``, 0 where nothing was counted and
        the relative error is about 1e-6 or less; with a dim ``channel`` where f has several. The
        attribute ``method`` says which it was.

    Raises
    ------
    NoClosedForm
        The set is not stationary, has fixed differences (shifted grids and lattices), or has more
        dims; or a quadrature does not converge to 1e-6.

    Examples
    --------
    >>> import mcspectra as mcs
    >>> d = variance_from_pair_correlation(mcs.Estimator("linear", dims=1), "jittered", 4)
    >>> round(float(d["variance"]) * 12 * 4**3, 6)
    1.0
    """
    subject = as_subject(estimator, sampler)
    given: AbstractEstimator = subject.estimator
    n = subject.sampler.check_count(n)
    given.check_sampler(subject.sampler, n)
    given.check_independent()
    source = given.randomized(subject.sampler)
    realizations = as_integer("realizations", realizations, least=1, most=MAX_REALIZATIONS)
    stream, threads = Stream.from_rng(rng), available_workers(workers)

    # Whether pairs are known, or may be counted
    exact = source.name in ("random", "jittered")
    base, steps = parts_of(source)
    alone = source.structure is Structure.TORUS and source.unbiased and not steps
    stationary = alone or (bool(steps) and steps[-1].stationary)
    moved_only = all(step.name in _MOVES for step in steps)
    lattice = moved_only and (base.fixed or base.name == "uniform-jitter")
    if not exact and (source.dims > 2 or not stationary or lattice):
        raise NoClosedForm(
            f"The variance of {source.spec} in {source.dims} dims is not found from pairs "
            "of points: give random or jittered, or in 1-D and 2-D a stationary set other than "
            "a lattice, such as one with shift; else use exact_variance or ",
            Function("variance_terms"),
            ".",
        )

    variance: Any = 0.0
    square_se: Any = 0.0
    for technique, count in enumerate(given.counts):
        g = given.primary_integrand(technique)
        if exact:
            # Random: all pairs; jittered: those in different cells
            (square, square_error), points = square_integral(g), n * count
            jittered: Any = source if source.name == "jittered" else None
            sides = jittered.sides(points) if jittered else (1,) * g.dims
            squares = []  # Σ_j (∫_cell j g)²
            for order in orders_of(math.prod(sides), g.dims):
                means, _ = stratum_moments(g, sides, np.zeros(g.dims), order)
                squares.append((means**2).mean(axis=0) / len(means) / (1 if jittered else points))
            coarse, fine = squares
            diverges = np.isinf(square)
            square = np.where(diverges, 0.0, square)
            part = np.where(diverges, np.inf, square / points - fine)
            error = np.where(diverges, 0.0, square_error / points + np.abs(fine - coarse))
            # Where the variance vanishes, rounding is all there is
            floor = _ROUNDING * square / points
            if not np.all(error <= np.maximum(_TOLERANCE * np.abs(part), floor)):
                raise NoClosedForm(
                    f"The quadrature over pairs of {g.spec} has an error of {np.max(error):.2g} in a "
                    f"variance of {np.max(square / points - fine):.6g}; use ",
                    *MEASURE_IT,
                    ".",
                )
            variance = variance + np.maximum(part, 0.0)
            continue
        one = _of_counted_pairs(source, n * count, g, stream)
        tree: MergeTree[MeanSums] = MergeTree()
        first = technique * realizations
        for state in map_in_order(one, range(first, first + realizations), threads):
            tree.add(state)
        value, se = tree.total().mean_and_error()
        variance, square_se = variance + value, square_se + se**2
    dims = ("channel",) if given.channels else ()
    shape = (given.channels,) if given.channels else ()
    return dataset(
        {
            "variance": (dims, np.reshape(variance, shape)),
            "variance_se": (dims, np.resize(np.sqrt(square_se), shape)),
        },
        estimator=given.spec,
        sampler=source.spec,
        n=n,
        method="known pairs" if exact else "counted pairs",
        realizations=0 if exact else realizations,
        seed=rng if isinstance(rng, int) else None,
    )


def _of_counted_pairs(
    sampler: Sampler, n: int, g: Integrand, stream: Stream
) -> Callable[[int], MeanSums]:
    """What a realisation says of the variance: the mean of A over its pairs."""
    if n > _MOST_POINTS:
        raise ParameterError(
            f"{n} points have too many pairs to count; give {_MOST_POINTS} at most."
        )
    # A(h) at h = k/N on the torus, from values at cell centers: (channels or 1, N, …)
    x = mesh(*[(np.arange(_GRID[g.dims]) + 0.5) / _GRID[g.dims]] * g.dims)
    values = np.moveaxis(values_at(g, x), -1, 0)
    axes = tuple(range(1, g.dims + 1))
    power = np.abs(np.fft.rfftn(values, axes=axes)) ** 2
    table = np.fft.irfftn(power, s=values.shape[1:], axes=axes) / x[..., 0].size
    square, _ = square_integral(g)
    if np.isinf(square).any():
        raise NoClosedForm(
            f"∫g² of {g.spec} diverges: with points that are each uniform the variance is infinite."
        )
    # The mean of the table instead of I²: what its sampling gets wrong cancels
    constant = square / n - table.reshape(len(table), -1).mean(axis=-1)
    add = pair_sum_1d if g.dims == 1 else pair_sum_2d

    def one(realization: int) -> MeanSums:
        points = sampler.draw_stream(n, stream, realization, 1)[0]
        sums = np.array([add(points, channel) for channel in table])
        return MeanSums.of(constant + 2.0 / n**2 * sums)

    return one
