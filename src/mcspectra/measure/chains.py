"""The error of the mean of correlated draws, such as Markov chains.

A stationary chain has the spectral density S(ν), with ν in cycles per draw.
The mean of a chain over n draws has the variance

    Var = ∫ S(ν) |W(ν)|² dν = (1/n) ∫ S(ν) F_n(ν) dν,    F_n(ν) = sin²(πnν) / (n sin²(πν)),

where W is the Fourier transform of n equal weights, and F_n is the Fejér kernel.
The integral is the power term of the variance. Stationary chains have no dc and cross terms.
S comes from an autoregression whose order is chosen by AIC, as in [Thompson2010]_.
The autocovariances are corrected for the subtracted mean.
If the mean has variance V, subtracting it lowers all autocovariances by V.

The scatter of the chains' means is a second, independent estimate.
The errors from the spectrum and from the scatter are pooled by their degrees of freedom.
If spectrum and scatter disagree, the chains are in different parts of the distribution.
The error of the mean then has no upper bound.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from mcspectra.core.checks import Array, as_real_array
from mcspectra.core.errors import DomainError, ParameterError
from mcspectra.core.results import dataset

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["CHAIN_SETTINGS", "ChainSettings", "chain_error", "quantity_error"]


@dataclass(frozen=True)
class ChainSettings:
    """Thresholds above which faults of chains are reported.

    Comments give numbers of cases from ``python -m benchmarks settings --chains``.
    """

    # Least number of draws of a chain. With fewer draws the autoregression has order 2 at most.
    # The largest order of the autoregression is a quarter of the number of draws.
    least_draws: int = 10
    # Largest deviation of the mean chain's power from its expected power, in standard errors.
    # If the power of the mean chain deviates more, the chains are correlated.
    # A normal law exceeds 5 standard errors with probability 6e-7.
    # A limit of 2.5 gives 2 false alarms in 475 cases.
    # A limit of 10 misses 50 of 50 sets of correlated chains, whose common part has weight 0.3.
    score: float = 5.0
    # Probability that a test reports a fault of chains without faults.
    # For each quantity, drift is tested twice, and the means of the chains are tested once.
    # A model of 100 quantities therefore has a false alarm in 2 % of runs.
    # A probability of 1e-2 gives 4 false alarms in 475 cases; 1e-6 finds the same faults as 1e-4.
    alarm: float = 1e-4
    # Length of a chain, in autocorrelation times, below which it still depends on its start.
    # With a length of 4, 43 of 50 chains with autocorrelation ρ = 0.99 are missed.
    # With a length of 16, 21 of 25 short chains are reported as stuck.
    forgotten: float = 8.0
    # Initial parts of a chain, as fractions of its draws.
    # The mean of each initial part is compared with the mean of the last half.
    # A smaller initial part would have too few draws, and its mean would not be nearly normal.
    # A larger initial part would reach into the last half of the chain.
    starts: tuple[float, ...] = (0.05, 0.1, 0.2)
    # `settled` is the p-value above which the draws after a burn-in count as stationary.
    # `margin` is the factor by which the burn-in is lengthened after it has been found.
    # At the end of the burn-in, the mean may still have a bias of one standard error.
    # `settled` and `margin` were tested on 200 sets of 4 chains with 1,000 draws each.
    # Draw number t is a normal number plus a drift of 5 exp(−t/100).
    # A burn-in is reported for 153 sets. The other 47 sets count as stuck.
    # In a stuck set, no end of the burn-in is found.
    # Of the 95 % intervals, 93 % contain the mean.
    # With the p-value 0.3 and the factor 1.5, a burn-in is reported for 76 % of the sets.
    # With the p-value 0.3 and the factor 1.5, 93 % of the intervals contain the mean.
    # With the p-value 0.1 and the factor 1.5, a burn-in is reported for 90 % of the sets.
    # With the p-value 0.1 and the factor 1.5, 89 % of the intervals contain the mean.
    settled: float = 0.2
    margin: float = 2.0
    # Significance level of the test whether the last two quarters of a chain differ.
    # If the p-value is smaller than this level, the chain counts as drifting until its end.
    # With the level 0.001, 4 of 50 linear drifts are reported as a burn-in.
    ends_alike: float = 0.05
    # Number of candidates for the length of the burn-in, equally spaced along a chain.
    # The largest fraction of a chain that may be burn-in is one half.
    # The last half of a chain is always kept, because earlier draws are compared with it.
    cuts: int = 40
    most_left_out: float = 0.5
    # Fraction of consecutive equal draws above which a chain is stuck.
    # Fractions from 0.05 to 0.1 give the same results.
    # With the fraction 0.2, a run of 110 equal draws among 1,000 is missed.
    run: float = 0.1
    # If a quantity has more different values than this, repeated draws are reported as a fault.
    # Discrete quantities, such as counts and flags, have few different values and repeat them.
    values: int = 20
    # Draws lie on two levels if more than this share of the variance lies between two groups.
    # One group has the draws above the mean, and the other group the draws below.
    # For a normal law, 0.64 of the variance lies between the two groups.
    # For a uniform law, the share between the groups is 0.75, and for two values it is 1.
    # If the limit is 0.7, 22 of 50 random walks are reported as draws on two levels.
    # If the limit is 0.95, two levels that are 8 standard deviations apart are missed.
    two_levels: float = 0.85
    # Draws on two levels are reported if chains move between the levels at most this often.
    # The limit is the mean number of moves per chain.
    # With 20 moves, the fraction of draws on each level has an error of about 1/√20 = 22 %.
    # Results are the same for values from 10 to 40.
    switches: int = 20
    # Tail index above which a tail is heavy. The variance is infinite for indices of at least ½.
    # An index from 2,000 draws has a standard error of about 0.1.
    # In a test with 50 chains of infinite variance, the threshold 0.5 finds 49 heavy tails.
    # The threshold 0.6 finds 47 of the 50 heavy tails, and the threshold 0.8 finds 25.
    heavy: float = 0.6
    # Least number of draws in a tail whose index is fitted. 20 draws give the index to about 0.3.
    # With a least number of 10 draws, there is one false alarm in 475 cases.
    # With 20 draws, there is no false alarm, and the same heavy tails are found as with 40 draws.
    least_tail: int = 20
    # For each quantity, the largest |draw| must be at least this number, or 0.
    # The largest |draw| must be at most 1 divided by `smallest`.
    # Within these limits, sums of squares of any number of draws are in the range of float64.
    smallest: float = 1e-100
    # Draws count as too few if the error has fewer degrees of freedom than this.
    # With 6 degrees of freedom the error is accurate to 1/√12 = 29 %.
    # A limit of 3 degrees of freedom misses one of 25 chains of 12 draws.
    # A limit of 12 degrees of freedom gives 12 false alarms in 475 cases.
    few_degrees: float = 6.0


CHAIN_SETTINGS = ChainSettings()
"""Default settings of chains."""

_VARIABLES: dict[str, tuple[str, ...]] = {
    **dict.fromkeys(("mean", "mcse", "ess", "spectrum_at_zero", "burn_in"), ()),
    **dict.fromkeys(("mean_ci", "mcse_ci", "ess_ci"), ("bound",)),
    **dict.fromkeys(("error_share", "draw_share", "chain_spectrum", "fitted_spectrum"), ("band",)),
    "chain_spectrum_ci": ("band", "bound"),
}
"""Variables of the result with their dims, without the dim quantity."""


def chain_error(draws: Any, *, weights: Any = None) -> xr.Dataset:
    """Estimate the error of the means of Markov chains by frequency, and find faults of the chains.

    Parameters
    ----------
    draws
        Real numbers: (n,) for one chain, (chain, draw), or (chain, draw, quantity).
        A DataArray or Dataset with the dims chain and draw is also possible.
        An object with a Dataset named posterior also works: ArviZ's InferenceData or DataTree.
    weights
        Importance weights or multiplicities of the draws, (n,) or (chain, draw), not negative.
        By default the weights are equal.
        The error is the linearized error of the ratio estimate Σwx/Σw.

    Returns
    -------
    xarray.Dataset
        ``mean`` has the interval ``mean_ci``.
        ``mcse`` is the standard error of the mean, with the interval ``mcse_ci``.
        ``ess`` is the effective sample size: the variance of the draws divided by mcse².
        ``ess`` has the interval ``ess_ci``, and exceeds n for antithetic chains.
        ``spectrum_at_zero`` is S(0).
        ``burn_in`` is the number of initial draws of each chain that depend on the start.
        All other results omit the draws of the burn-in.

        The dim ``band`` has octaves of frequency, named by their periods.
        ``band_low`` and ``band_high`` are the ends of each band in cycles per draw.
        ``error_share`` is the share of each band in the squared error.
        ``draw_share`` is the share of each band in the variance of the draws.
        ``chain_spectrum`` is the measured mean of S in a band, with ``chain_spectrum_ci``.
        ``fitted_spectrum`` is the mean of S in a band from the autoregression.

        The coordinate ``cause`` has comma-separated names of faults, or none.
        The coordinate ``evidence`` has a sentence on each fault.
        If the draws have several quantities, the result also has the dim ``quantity``.
        For stuck chains or heavy tails the error has no upper bound, and intervals are infinite.

    Raises
    ------
            DomainError, ParameterError
        If there are fewer than 10 draws, dims are wrong, or values are not finite.
        If weights are negative or all zero in a chain.
        If the squares of draws exceed the range of floats.

    Notes
    -----
    S(0) from an autoregression has a smaller error than two alternatives.
    The autoregression also gives intervals with a coverage closer to 95 % than the alternatives.
    Measurements are in docs/theory.md, "Chains".
    One alternative, the initial monotone sequence, cannot resolve antithetic or oscillating chains.
    The other alternative, the mean of the spectrum at the lowest frequencies, is less accurate.
    The cost is O(n log n).

    Examples
    --------
    >>> import mcspectra as mcs, numpy as np
    >>> x = np.random.default_rng(1).normal(size=(4, 1001))
    >>> result = mcs.measure.chain_error(x[:, 1:] - 0.9 * x[:, :-1])  # antithetic
    >>> float(result["ess"]) > 50 * 4000, str(result["cause"].values)
    (True, 'none')
    """
    names, values = _quantities(draws)  # (quantity, chain, draw)
    chains, n = values.shape[1:]
    w = np.ones((chains, n))
    if weights is not None:
        w = as_real_array("weights", weights)
        if w.shape not in {(chains, n), (n,)} or (w.ndim == 1 and chains > 1):
            raise ParameterError(
                f"weights have shape {w.shape}; give one for each draw, shape {(chains, n)}."
            )
        w = w.reshape(chains, n)
        if not np.isfinite(w).all() or w.min() < 0 or not w.any(axis=1).all():
            raise DomainError(
                "weights are negative, not finite, or all zero in a chain; give finite "
                "numbers from 0, such as multiplicities or importance weights."
            )
        w = w / w.mean()

    sizes = np.abs(values).max(axis=(1, 2))
    smallest = CHAIN_SETTINGS.smallest
    if ((sizes > 1 / smallest) | ((sizes > 0) & (sizes < smallest))).any():
        raise DomainError(
            f"draws are as large as {sizes.max():.3g} and as small as {sizes.min():.3g}; scale "
            f"each quantity to a size between {smallest:g} and {1 / smallest:g}."
        )

    found = [quantity_error(each, w) for each in values]
    note = None
    if chains == 1:
        note = (
            "One chain cannot show a mode that it never reached; run several from scattered starts."
        )
    elif chains > n:
        note = (
            f"The first of {chains} × {n} draws is the axis of the chains; transpose if it is not."
        )
    dims, kept = (("quantity",), slice(None)) if names else ((), 0)
    gathered = {k: np.array([each[k] for each in found])[kept] for k in found[0]}
    edges = _edges(n)
    periods = [f"above {1 / edges[1]:.0f}"]
    periods += [f"{1 / b:.0f} to {1 / a:.0f}" for a, b in itertools.pairwise(edges[1:])]
    return dataset(
        {name: ((*dims, *own), gathered[name]) for name, own in _VARIABLES.items()},
        {
            "bound": ["low", "high"],
            "band": periods,
            "band_low": ("band", edges[:-1]),
            "band_high": ("band", edges[1:]),
            **({"quantity": names} if names else {}),
            **{name: (dims, gathered[name]) for name in ("cause", "evidence")},
        },
        analysis="chains",
        chains=chains,
        draws=n,
        weighted=int(weights is not None),
        note=note,
    )


def _quantities(draws: Any) -> tuple[list[str], Array]:
    """Return names of the quantities (empty for one) and values (quantity, chain, draw)."""
    import xarray as xr

    # Objects such as ArviZ's InferenceData hold the draws in a group named posterior
    given = getattr(draws, "posterior", draws)
    if isinstance(given, xr.DataTree):
        given = given.to_dataset()
    parts, least = {"": given}, CHAIN_SETTINGS.least_draws
    if isinstance(given, xr.Dataset):
        parts = {str(name): each for name, each in given.data_vars.items()}
    names, found = [], []
    for name, part in parts.items():
        what = f"draws of {name!r}" if name else "draws"
        labels: list[Any] = []
        if isinstance(part, xr.DataArray):
            if "draw" not in part.dims:
                raise ParameterError(
                    f"{what} have the dims {', '.join(map(str, part.dims)) or 'none'}; name the "
                    "axis of time 'draw', and that of several chains 'chain'."
                )
            part = part if "chain" in part.dims else part.expand_dims("chain")
            part = part.transpose("chain", "draw", ...)
            labels, part = [part[dim].values for dim in part.dims[2:]], part.values
        x = as_real_array(what, part)
        shape, x = x.shape, x[None] if x.ndim == 1 else x
        if x.ndim < 2 or (x.ndim > 3 and not name) or not x.size or x.shape[1] < least:
            raise ParameterError(
                f"{what} have shape {shape}; give at least {least} draws, of shape (n,), "
                "(chain, draw) or (chain, draw, quantity)."
            )
        if bad := int(np.count_nonzero(~np.isfinite(x))):
            raise DomainError(f"{what} hold {bad} NaN or infinite values; give finite numbers.")
        labels = labels or [range(size) for size in x.shape[2:]]
        places = [",".join(map(str, place)) for place in itertools.product(*labels)]
        names += [f"{name}[{place}]" if place else name for place in places]
        found.append(np.moveaxis(x.reshape(*x.shape[:2], -1), -1, 0))
    if not found:
        raise ParameterError(
            "draws hold no variables; give variables with the dims chain and draw."
        )
    if "" in parts:  # For an array instead of named variables, the name of a quantity is its index
        names = [name.strip("[]") for name in names if name]
    return names, np.ascontiguousarray(np.concatenate(found))


@dataclass(frozen=True)
class _ChainFit:
    """An autoregression of chains with a common law, and the error of a chain's mean."""

    # Weights of successive draws, beginning with 1. The weighted sum of draws is white noise
    coefficients: Array
    variance: float  # variance of a chain's mean, ∫ S F_n / n
    spread: float  # variance of a single draw
    at_zero: float  # S(0)
    degrees: float  # degrees of freedom of the variance
    spectrum: Array  # spectral density S at the frequencies
    error: Array  # contribution of each frequency to the variance of a chain's mean
    power: Array  # periodogram at the frequencies
    frequency: Array  # frequencies j / length in cycles per draw, from 0 to ½


def _fitted(z: Array) -> _ChainFit:
    """Fit an autoregression to chains (chain, draw), after subtracting the mean of each chain."""
    from scipy.fft import irfft, next_fast_len, rfft
    from scipy.linalg import solve_toeplitz

    chains, n = z.shape
    length = next_fast_len(2 * n, real=True)
    frequency = np.arange(length // 2 + 1) / length
    both = np.full(frequency.size, 2.0 / length)  # ν and −ν both count, but 0 and ½ count once
    both[0] /= 2.0
    both[-1] /= 1.0 + (length % 2 == 0)
    with np.errstate(invalid="ignore"):
        kernel = (np.sin(np.pi * n * frequency) / np.sin(np.pi * frequency)) ** 2 / n
    kernel[0] = n

    # Fit the autoregression to the autocovariances of the draws minus their mean.
    # Then add the variance of the mean to the autocovariances, and fit again
    centred = z - z.mean(axis=1, keepdims=True)
    power = np.mean([np.abs(rfft(row, length)) ** 2 for row in centred], axis=0)
    most = int(min(n // 4, 10 * math.log10(n * chains)))
    removed = irfft(power, length)[: most + 3] / n
    variance = 0.0
    for _ in range(2):
        covariance = removed + min(variance, removed[0])
        a, noise, best = np.ones(1), covariance[0], math.inf
        chosen, innovation = a, noise
        for order in range(most + 1):  # Levinson's recursion
            if order:
                k = -float(a @ covariance[order:0:-1]) / noise
                a = np.append(a, 0.0) + k * np.append(a, 0.0)[::-1]
                noise *= 1.0 - k * k
            if noise <= 1e-12 * covariance[0]:
                break
            criterion = n * chains * math.log(noise) + 2 * order
            if criterion < best:
                best, chosen, innovation = criterion, a, noise
        spectrum = innovation / np.abs(rfft(chosen, length)) ** 2
        error = both * spectrum * kernel / n
        variance = float(error.sum())

    # Compute the error of log S(0) by the delta method.
    # The covariance of the coefficients is proportional to the inverse autocovariance matrix.
    # AIC may choose an order that is too large by one or two.
    # Therefore the error is computed for an order above the chosen order
    order = len(chosen) + 1
    sums = solve_toeplitz(covariance[:order], np.ones(order)).sum() * innovation
    square = (2.0 + 4.0 * max(float(sums), 0.0) / float(chosen.sum()) ** 2) / (n * chains)
    spread, at_zero, degrees = float(covariance[0]), float(spectrum[0]), 2.0 / square
    power /= n
    return _ChainFit(chosen, variance, spread, at_zero, degrees, spectrum, error, power, frequency)


def quantity_error(x: Array, w: Array, settings: ChainSettings = CHAIN_SETTINGS) -> dict[str, Any]:
    """Return the variables of the result for one quantity (chain, draw) with weights."""
    n = x.shape[1]
    dropped = _burn_in(w * x, settings)
    if not dropped:
        return _stationary_error(x, w, _edges(n), "", settings)
    if dropped > settings.most_left_out * n:
        drifts = "the chain drifts: its mean still moves after half of the draws"
        return _stationary_error(x, w, _edges(n), drifts, settings)
    rest = _stationary_error(x[:, dropped:], w[:, dropped:], _edges(n), "", settings)
    if "stuck-chain" in rest["cause"]:  # A chain is stuck after the burn-in
        return _stationary_error(x, w, _edges(n), "", settings)
    said = (
        f"the first draws depend on where the chains began, so the first {dropped} of {n} of each "
        "chain are excluded from the mean and its error: drop them"
    )
    causes = "" if rest["cause"] == "none" else f", {rest['cause']}"
    evidence = f"; {rest['evidence']}" if rest["evidence"] else ""
    return rest | {
        "burn_in": dropped,
        "cause": f"burn-in{causes}",
        "evidence": f"burn-in: {said}{evidence if causes else ''}",
    }


def _burn_in(z: Array, settings: ChainSettings) -> int:
    """Return the number of draws of each chain that depend on its start, or n if it exceeds n/2.

    The mean of the first draws, over all chains, is compared with the mean of the last half.
    The errors of both means are computed from the spectrum of the chains at frequency 0.
    This spectrum is fitted to the last half of each chain.
    Draws are replaced by normal scores, which have no heavy tails.
    """
    from scipy.special import fdtrc, ndtri

    chains, n = map(int, z.shape)
    half = n // 2
    if half < settings.least_draws or not np.ptp(z):
        return 0
    # Equal draws share the mean of their ranks
    _, place, counts = np.unique(z, return_inverse=True, return_counts=True)
    ranks = (np.cumsum(counts) - 0.5 * (counts - 1.0))[place].reshape(z.shape)
    scores = ndtri((ranks - 0.5) / z.size)
    last, mean = scores[:, half:], scores.mean(axis=0)
    if not np.ptp(last, axis=1).all():
        return 0
    fit = _fitted(last)

    def chance(start: int, stop: int, first: int = half) -> float:
        """Return the p-value of the difference between two means of draws.

        One mean is over the draws from `start` to `stop`, the other over the draws from `first` on.
        """
        spread = fit.at_zero * (1.0 / (stop - start) + 1.0 / (n - first)) / chains
        away = float(mean[start:stop].mean() - mean[first:].mean())
        return float(fdtrc(1, fit.degrees, away**2 / spread))

    sizes = [max(1, round(part * n)) for part in settings.starts]
    if min(chance(0, size) for size in sizes) * len(sizes) > settings.alarm:
        return 0
    # If the means of the last two quarters differ significantly, the chain drifts until its end
    middle = (half + n) // 2
    if chance(half, middle, middle) < settings.ends_alike:
        return n
    for cut in range(1, settings.cuts + 1):
        start = math.ceil(cut * n / settings.cuts)
        if start + sizes[0] > half:
            break
        stops = [min(start + size, half) for size in sizes]
        if min(chance(start, stop) for stop in stops) > settings.settled:
            return min(math.ceil(settings.margin * start), int(settings.most_left_out * n))
    return n


def _stationary_error(
    x: Array, w: Array, edges: Array, drifts: str, settings: ChainSettings
) -> dict[str, Any]:
    """Return result variables for draws (chain, draw) without a burn-in.

    The edges are the ends of the bands of frequency.
    `drifts` describes a drift that the search for a burn-in found, or is empty without a drift.
    """
    from scipy.special import fdtrc, gammaincinv, stdtrit

    chains, n = x.shape
    mean = float((w * x).sum() / w.sum())
    z = w * (x - mean)  # To first order, the mean of z is the error of Σwx/Σw
    size = edges.size - 1
    if not np.ptp(x, axis=1).any() or not np.any(z):
        sizes = {"band": size, "bound": 2}
        nothing = {k: np.full([sizes[d] for d in v], math.nan) for k, v in _VARIABLES.items()}
        constant = (
            f"the draws are constant: all are {mean:g}, and their mean has no error to estimate"
        )
        stuck = "no chain moves: each repeats one value, and the values of the chains differ"
        said = f"stuck-chain: {stuck if np.ptp(x) and np.any(z) else constant}"
        ends = {"mean_ci": [-math.inf, math.inf], "mcse_ci": [0.0, math.inf]}
        return {
            **nothing,
            **ends,
            "mean": mean,
            "burn_in": 0,
            "cause": "stuck-chain",
            "evidence": said,
        }
    causes: dict[str, str] = {}

    # If chains move together, their error is the error of their mean chain.
    # Whiten the chains, and divide the power of the sum of all chains by the sum of their powers.
    # If m chains are independent, the ratio of powers is m times a Beta(1, m − 1) variable
    fit = own = _fitted(z)
    series, remark = z, ""
    if chains > 1:
        white = np.array([np.convolve(row, fit.coefficients, "valid") for row in z])
        waves = np.fft.rfft(white, axis=1)[:, 1 : (n + 1) // 2]
        each = np.maximum((np.abs(waves) ** 2).sum(axis=0), np.finfo(float).tiny)
        together = np.abs(waves.sum(axis=0)) ** 2 / each
        score = (together.mean() - 1) * math.sqrt(each.size * (chains + 1) / (chains - 1))
        if abs(score) > settings.score:
            remark = (
                f"the mean of the {chains} chains varies {together.mean():.2g} times as much as "
            )
            remark += "that of independent ones"
            series = z.mean(axis=0, keepdims=True)
            own = _fitted(series)
        if score > settings.score:
            causes["correlated-replicates"] = f"{remark}, as chains of one seed or one start do"
    rows, means = len(series), series.mean(axis=1)
    tau = n * own.variance / own.spread
    within, degrees = own.variance / rows, own.degrees
    between = float(means.var(ddof=1)) / rows if rows > 1 else 0.0
    variance = (degrees * within + (rows - 1) * between) / (degrees + rows - 1)

    # Find chains that disagree, repeat a value, drift or depend on their start
    stuck = ""
    ratio = between / within
    time = np.arange(n) - (n - 1) / 2
    time /= np.sqrt(time @ time)
    slopes = series @ time
    flat = _fitted(series - slopes.mean() * time)
    shared = fdtrc(1, flat.degrees, rows * slopes.mean() ** 2 / flat.at_zero)
    drift = (
        min(shared, fdtrc(rows, flat.degrees, (slopes**2).mean() / flat.at_zero))
        < settings.alarm / 2
    )
    moves = np.diff(x, axis=1, prepend=math.nan, append=math.nan) != 0
    run = int(np.diff(np.flatnonzero(moves)).max())
    repeats = run >= max(settings.run * n, settings.least_draws)
    if repeats and np.unique(x).size > settings.values:
        stuck = f"a chain repeats one value for {run} of {n} draws"
    elif rows > 1 and fdtrc(rows - 1, degrees, ratio) < settings.alarm:
        stuck = f"the means of the chains differ {math.sqrt(ratio):.2g} times as much as the draws "
        stuck += "within a chain explain: they are in different parts of the distribution"
    elif n < settings.forgotten * tau or drift or drifts:
        side = x > x.mean(axis=1, keepdims=True)
        low, high = x[~side], x[side]
        share = side.mean() * (1 - side.mean()) * (high.mean() - low.mean()) ** 2 / x.var()
        switches = int(np.count_nonzero(np.diff(side, axis=1)))
        if share > settings.two_levels and switches <= settings.switches * chains:
            stuck = f"the draws lie on two levels, with {switches} moves from one to the other"
        else:
            stuck = "the chain drifts: its mean moves with time by more than its error explains"
            if not drift:
                stuck = (
                    drifts or f"the chain drifts: {n} draws are {n / tau:.2g} autocorrelation times"
                )
    if stuck:
        causes["stuck-chain"] = stuck
        variance = max(variance, between)

    # Fit the tail index to draws that are one autocorrelation time apart
    index = _tail_index(z[:, :: max(1, math.ceil(tau))].ravel(), settings.least_tail)
    if index > settings.heavy:
        causes["heavy-tail"] = f"the tail index is {index:.2f}: above ½ the variance is infinite"
    degrees += rows - 1
    if not stuck and degrees < settings.few_degrees:
        causes["few-realizations"] = "there are too few draws to know their error to 30 %"

    # Intervals use Student's t and χ². They are infinite if the error has no upper bound
    bounded = not {"stuck-chain", "heavy-tail"} & set(causes)
    mcse = math.sqrt(variance)
    half = float(stdtrit(degrees, 0.975)) * mcse if bounded else math.inf
    low, high = np.sqrt(0.5 * degrees / gammaincinv(0.5 * degrees, [0.975, 0.025])) * mcse
    high = float(high) if bounded else math.inf
    spread = float((w * (x - mean) ** 2).sum() / w.sum()) + variance
    of_grid = np.searchsorted(edges, fit.frequency, side="right").clip(1, size) - 1
    cells = np.bincount(of_grid, minlength=size)
    error = np.bincount(of_grid, own.error, size)
    fitted, power = (np.bincount(of_grid, v, size) / cells for v in (fit.spectrum, fit.power))
    # In the band below 1/n, the spectrum is measured by the scatter of the chains' means
    freedom = 2.0 * rows * n * np.diff(edges)
    power[0], freedom[0] = (n * means.var(ddof=1), rows - 1) if rows > 1 else (math.nan, math.nan)
    chances = 2.0 * gammaincinv(0.5 * freedom[:, None], [0.975, 0.025])
    draw = fitted * np.diff(edges)
    return {
        "mean": mean,
        "mean_ci": [mean - half, mean + half],
        "mcse": mcse,
        "mcse_ci": [float(low), high],
        "ess": spread / variance,
        "ess_ci": [spread / high**2, spread / float(low) ** 2],
        "spectrum_at_zero": fit.at_zero,
        "error_share": error / error.sum(),
        "draw_share": draw / draw.sum(),
        "chain_spectrum": power,
        "chain_spectrum_ci": (freedom * power)[:, None] / chances,
        "fitted_spectrum": fitted,
        "burn_in": 0,
        "cause": ", ".join(causes) or "none",
        "evidence": "; ".join(f"{k}: {v}" for k, v in causes.items()) or remark,
    }


def _tail_index(z: Array, least: int) -> float:
    """Return k̂ of a generalized Pareto law of the largest |z − median| [Vehtari2024]_, or NaN."""
    most = int(min(z.size / 10, 3 * math.sqrt(z.size)))
    if most < least:
        return math.nan
    excess = np.sort(np.abs(z - np.median(z)))[-most - 1 :]
    excess = excess[1:] - excess[0]
    if not excess[most // 4] > 0:
        return math.nan
    # The Pareto law has the shape k and the scale σ. Average b = −k/σ over a grid of values of b.
    # The weight of each value of b is its posterior density.
    # The first quartile of the values, minus the threshold of the tail, sets the scale of the grid
    grid = 30 + int(math.sqrt(most))
    b = 1 - np.sqrt(grid / (np.arange(grid) + 0.5))
    b = b / (3 * excess[int(most / 4 + 0.5) - 1]) + 1 / excess[-1]
    k = np.log1p(-b[:, None] * excess).mean(axis=1)
    likelihood = most * (np.log(-b / k) - k - 1)
    weight = np.exp(likelihood - likelihood.max())
    index = float(np.log1p(-(b @ weight) / weight.sum() * excess).mean())
    # Move the tail index toward ½, by a prior that counts as much as ten draws
    return (most * index + 5) / (most + 10)


def _edges(n: int) -> Array:
    """Return the ends of the bands: octaves from ½ down to 1/n, then one band from 0 to 1/n."""
    return np.append(0.0, 2.0 ** np.arange(-math.floor(math.log2(n)), 0))
