"""What is measured of a sampler for its card: points, spectrum, projections, rates, quality, cost."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, final

from mcspectra.core.checks import Array
from mcspectra.core.errors import McspectraError
from mcspectra.core.spec import parse_chain
from mcspectra.core.streams import Stream
from mcspectra.estimators import Estimator
from mcspectra.quality import quality_figures, summarize
from mcspectra.quality.figures import different_realizations
from mcspectra.samplers import SAMPLERS, Sampler, sampler
from mcspectra.samplers.base import Randomized, Structure
from mcspectra.samplers.facts import Facts, sampler_facts
from mcspectra.samplers.optimised import OptimisedSampler
from mcspectra.spectra.power import power_spectrum
from mcspectra.variance.convergence import convergence

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["FULL", "QUICK", "Card", "Effort", "measure_card"]

_SHARED_SETS = 8  # optimised sets, used again under random translations
_PROJECTED_DIMS = 4
_QUALITY = (
    "relative_minimum_distance",
    "star_discrepancy",
    "centered_discrepancy",
    "diaphony",
    "transport_cost",
    "t_value",
)
_INTEGRANDS = {1: ("gaussian", "step(at=0.3)"), 2: ("gaussian", "disk")}


@final
@dataclass(frozen=True, kw_only=True)
class Effort:
    """How much is drawn for a card.

    Attributes
    ----------
    n
        Points of the pictures, the spectrum and the quality figures; the nearest possible count.
    spectra, rates
        Realisations of the spectrum, and of the variance at each of `counts`.
    """

    n: int = 1024
    spectra: int = 200
    rates: int = 2000
    counts: tuple[int, ...] = (16, 64, 256, 1024, 4096)
    slow_counts: tuple[int, ...] = (16, 64, 256, 1024)
    slow_rates: int = 400


FULL = Effort()
QUICK = Effort(
    n=256, spectra=40, rates=300, counts=(16, 64, 256), slow_counts=(16, 64, 256), slow_rates=100
)


@final
@dataclass(frozen=True, kw_only=True)
class Card:
    """One sampler, measured.

    Attributes
    ----------
    spec
        What the pictures and the spectrum show.
    randomized
        What the rates are of: a set that is the same every time is randomised first.
    points
        One realisation, (n, dims).
    projected
        The axes 2 and 3 of a set in 4 dims, (n, 2); None where it cannot do 4.
    spectrum
        Result of `power_spectrum`.
    rates
        By integrand: rate and its interval.
    quality
        By figure: its long name, mean and standard error.
    speed
        Points per second, one thread, nothing cached.
    """

    name: str
    facts: Facts | None
    spec: str
    randomized: str
    n: int
    points: Array
    projected: Array | None
    spectrum: xr.Dataset
    rates: Mapping[str, tuple[float, float, float]]
    quality: Mapping[str, tuple[str, float, float]]
    speed: float


def measure_card(spec: str, *, effort: Effort = FULL, rng: int = 0) -> Card:
    """Measure a sampler: in 2-D, else in the only dims it can do.

    Raises
    ------
    McspectraError
        The spec cannot be read, or a sampler needs parameters that it lacks.
    """
    name = parse_chain(spec)[0].name
    source = _in_two_dims(spec)
    light = _shared(source)
    free = light if light.unbiased else _randomized(light)
    n = source.nearest_count(effort.n)
    slow = light != source
    return Card(
        name=spec,
        facts=sampler_facts(name) if name in SAMPLERS else None,
        spec=source.spec,
        randomized=free.spec,
        n=n,
        points=light.draw(n, rng=rng)[0],
        projected=_projection(spec, n, rng),
        spectrum=_spectrum(light, n, effort, rng, slow=slow),
        rates={text: _rate(text, free, effort, rng, slow=slow) for text in _integrands(source)},
        quality=_quality(light, n, rng),
        speed=n / _seconds(source, n, rng),
    )


def _in_two_dims(spec: str) -> Sampler:
    """Make the sampler in 2-D, else in 1-D or 3-D; the error is that of 2-D."""
    reason: McspectraError | None = None
    for dims in (2, 1, 3):
        try:
            return sampler(spec, dims)
        except McspectraError as error:
            reason = reason or error
    assert reason is not None
    raise reason


def _shared(source: Sampler) -> Sampler:
    """Make do with a few sets of an optimised sampler, each used many times."""
    if isinstance(source, OptimisedSampler):
        return replace(source, sets=source.sets or _SHARED_SETS)
    if isinstance(source, Randomized) and isinstance(source.base, OptimisedSampler):
        return replace(source, base=_shared(source.base))
    return source


def _randomized(source: Sampler) -> Sampler:
    step = "owen" if source.structure is Structure.DIGITS else "shift"
    return sampler(f"{source.spec} | {step}", source.dims)


def _projection(spec: str, n: int, rng: int) -> Array | None:
    try:
        source = _shared(sampler(spec, _PROJECTED_DIMS))
    except McspectraError:
        return None
    points: Array = source.draw(source.nearest_count(n), rng=rng)[0, :, 2:]
    return points


def _spectrum(source: Sampler, n: int, effort: Effort, rng: int, *, slow: bool) -> xr.Dataset:
    wide = round(2.0 * n ** (1.0 / source.dims))
    stream, most = Stream.from_rng(rng), _SHARED_SETS if slow else effort.spectra
    count = different_realizations(source, n, stream, most)
    return power_spectrum(source, n, half_width=wide, realizations=count, rng=rng)


def _integrands(source: Sampler) -> tuple[str, ...]:
    return _INTEGRANDS.get(source.dims, ("gaussian",))


def _rate(
    text: str, source: Sampler, effort: Effort, rng: int, *, slow: bool
) -> tuple[float, float, float]:
    """Return rate and interval of the variance; NaN where fewer than two counts are possible."""
    wanted = effort.slow_counts if slow else effort.counts
    counts = sorted({source.nearest_count(n) for n in wanted})
    realizations = effort.slow_rates if slow else effort.rates
    if len(counts) < 2:
        return (float("nan"),) * 3
    estimator = Estimator(text, dims=source.dims)
    curve = convergence(estimator, source, counts, realizations=realizations, rng=rng)
    low, high = (float(end) for end in curve["rate_ci"])
    return float(curve["rate"]), low, high


def _seconds(source: Sampler, n: int, rng: int) -> float:
    """Best time of a few draws on one thread, without the cache."""
    stream = Stream.from_rng(rng)

    def draw(realization: int) -> Any:
        if isinstance(source, OptimisedSampler):
            return source._optimize(n, stream.keys(realization, 1)[0], lambda _: None)
        return source.draw_stream(n, stream, realization, 1)

    best = float("inf")
    for realization in range(3):
        start = time.perf_counter()
        draw(realization)
        best = min(best, time.perf_counter() - start)
        if best > 1.0:
            break
    return best


def _quality(source: Sampler, n: int, rng: int) -> dict[str, tuple[str, float, float]]:
    """Long name, mean and standard error of the figures that can be had."""
    count = different_realizations(source, n, Stream.from_rng(rng), _SHARED_SETS)
    found = quality_figures(source, n, figures=_QUALITY, realizations=count, rng=rng)
    return {
        figure.name: (figure.long_name, figure.mean, figure.standard_error)
        for figure in summarize(found)
        if not figure.missing
    }
