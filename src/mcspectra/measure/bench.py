"""Comparison of samplers on standard integrands by variance, rank, spectrum, quality and speed.

The module combines `convergence`, `power_spectrum`, `pair_correlation` and `quality_figures`.
A bench measures speeds, which differ from run to run.
It is therefore not an `Analysis`, whose results have the same bits in every run.
"""

from __future__ import annotations

import math
import time
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from mcspectra.core.checks import Array, as_integer
from mcspectra.core.display import counted
from mcspectra.core.errors import McspectraError, ParameterError
from mcspectra.core.progress import report
from mcspectra.core.results import dataset
from mcspectra.core.spec import short_spec
from mcspectra.core.streams import Stream
from mcspectra.estimators import Estimator
from mcspectra.measure.converge import convergence
from mcspectra.quality import quality_figures
from mcspectra.quality.figures import different_realizations
from mcspectra.samplers import GivenPoints, Owen, Sampler, Shift, as_sampler
from mcspectra.samplers.base import Randomized
from mcspectra.samplers.law import bases_to_scramble
from mcspectra.samplers.optimised import OptimisedSampler
from mcspectra.spectra.pairs import pair_correlation
from mcspectra.spectra.power import power_spectrum
from mcspectra.spectra.shapes import radial_statistics

if TYPE_CHECKING:
    import xarray as xr

__all__ = [
    "BENCH_QUALITY",
    "SHARED_SETS",
    "Task",
    "free_of",
    "making_seconds",
    "randomized",
    "ranks",
    "sampler_bench",
    "shared_sets",
    "standard_tasks",
]

BENCH_QUALITY = (
    "relative_minimum_distance",
    "star_discrepancy",
    "centered_discrepancy",
    "generalized_l2_discrepancy",
    "diaphony",
    "transport_cost",
    "t_value",
)
"""Figures of quality that are measured at every count."""

SHARED_SETS = 8
"""Number of slowly optimized sets that are reused under random translations."""


@dataclass(frozen=True)
class BenchSettings:
    """Numbers of sets of a bench, and sizes of its spectra and pictures."""

    # Given sets are measured without a randomization if each count has at least this many sets.
    # A variance from 16 sets has a relative standard error of 35 %.
    enough_sets: int = 16
    # Half widths of the spectra in 1, 2 and 3 dims, for 513, 16,641 and 68,921 frequencies.
    # With more frequencies, maps of spectra would be shortened when they are printed.
    # In 4 or more dims, no spectra are computed.
    half_widths: tuple[int, ...] = (256, 64, 20)
    # Number of sets over which the measures of quality are averaged (see `quality_figures`).
    # At 256 points in 2-D, the quality of two scrambled nets differs by 1 to 5 %.
    # The quality of two sets of random points differs by 11 to 27 %.
    # Means of 8 sets are therefore accurate to 2 % for nets and 10 % for random points.
    quality_sets: int = 8
    # Least number of sets for an interval of the pair correlation.
    # With 8 sets, Student's t makes the interval a fifth wider than a normal law.
    # With fewer sets the interval would hide the curve in a plot.
    few_sets: int = 8
    # Largest number of sets over which the pair correlation is averaged.
    # At 256 points in 2-D, 8 sets give the pair correlation an interval of half width 0.05.
    # With 16 sets the half width of the interval is 0.03, and with 32 sets it is 0.02.
    pair_sets: int = 16
    # Largest distance of the pair correlation, in mean spacings n^(−1/d).
    # Correlations of blue noise end before 6 spacings, and 100 bins then resolve its peak.
    pair_spacings: float = 6.0
    # Largest number of points of a drawn set. Pictures of more points have overlapping dots.
    most_pictured: int = 1024
    # Largest number of dims of the integrands. Genz's difficulty is divided among the dims.
    # In more dims, Genz's functions would be nearly linear along each axis.
    most_dims: int = 64


_SETTINGS = BenchSettings()
_LEVEL = 0.95  # Level of the simultaneous intervals of ranks

# Genz's difficulty of each family: the sum of its coefficients a_i over the dims
_GENZ = {
    "oscillatory": 9.0,
    "product-peak": 7.25,
    "corner-peak": 1.85,
    "gaussian": 7.03,
    "continuous": 20.4,
    "discontinuous": 4.3,
}
_KINDS = {"continuous": "kink", "discontinuous": "jump"}


class Task(NamedTuple):
    """A standard integrand: its kind (``smooth``, ``kink`` or ``jump``), spec and dims."""

    kind: str
    spec: str
    dims: int

    @property
    def title(self) -> str:
        """Name, kind and number of dims of the integrand."""
        name = self.spec.partition("(")[0].removeprefix("genz-")
        return f"{name} ({self.kind}), {self.dims}-D"


def sampler_bench(
    samplers: Sequence[Any],
    *,
    counts: Sequence[int] = (16, 64, 256, 1024),
    dims: int | Sequence[int] = 2,
    realizations: int = 400,
    rng: int = 0,
) -> xr.Dataset:
    """Compare samplers on standard integrands, and by their spectra, quality and speed.

    Parameters
    ----------
    samplers
        Samplers, spec strings or arrays of points, as in `as_sampler`.
        A spec string gives one sampler for each number in `dims`.
        Sampler objects and arrays are used only in their own number of dims.
        Sets that are always the same are randomized before variances are measured.
        Digital nets are randomized by Owen scrambling, and other sets by a random shift.
        Given sets are also randomized if there are fewer than 16 sets with the same count.
        Points of files are recognized as nets in base 2, 3 or 5.
    counts
        Numbers of points. Each sampler uses its allowed counts nearest to these numbers.
    dims
        One or several numbers of dims. The integrands are built in each number of dims.
        Spectra, pair correlations, quality and speed use only the first of these numbers.
        Projections are measured in each of the given numbers of dims.
    realizations
        Number of realizations for each variance. The number of given sets is an upper limit.
    rng
        Seed of the random numbers, an integer.

    Returns
    -------
    xarray.Dataset
        ``mean``, ``variance`` and ``variance_ci`` have the dims (sampler, integrand, n).
        ``points_made`` is the number of points that the sampler used for n: an allowed count.

        ``rate``, ``rate_ci`` and ``rank`` have the dims (sampler, integrand).
        Samplers are ranked by n · variance at the largest n.
        ``rank_ci`` holds simultaneous 95 % intervals of all ranks.

        The figures of quality and ``points_per_second`` have the dims (sampler, n).
        ``points_per_second`` is the speed of one thread. It is NaN for points from files.

        Spectra are computed in 1 to 3 dims. ``power`` has the dims (sampler, m0, …).
        ``radial_power`` and ``anisotropy_db`` have the dims (sampler, radius).

        ``pair_correlation`` and ``pair_correlation_ci`` have the dims (sampler, r).

        ``points`` (sampler, point, axis) is one set in the sampler's largest number of dims.
        ``pictured_n`` is the number of points of the spectra and pair correlations.
        ``spectrum_sets``, ``pair_sets`` and ``quality_sets`` are the numbers of averaged sets.

        Values are NaN if a sampler does not allow the dims or the count.
        Variances may be measured with an added randomization.
        The coordinate ``randomization`` and the attribute ``note`` name this randomization.

    Raises
    ------
    ParameterError
        If there are no samplers, two samplers are equal, or a sampler allows none of the dims.
    McspectraError
        If a sampler cannot be made, or cannot draw points. The message gives the reason.

    Notes
    -----
    Six integrands are Genz's families [Genz1984]_ with his difficulties.
    Two other integrands are a half-space with an oblique border, and Sobol's g-function.
    In up to 3 dims, there is also the indicator function of a ball.
    Genz's families are smooth, have a kink, or have an axis-parallel jump.
    All results except ``points_per_second`` depend only on the samplers and the seed.
    Every sampler has its own stream of random numbers.
    """
    for name, given in (("samplers", samplers), ("counts", counts), ("dims", dims)):
        if not isinstance(given, list | tuple | range) and not (
            name == "dims" and isinstance(given, int | float)
        ):
            raise ParameterError(f"{name} is {given!r:.80}; give a list.")
    listed = dims if isinstance(dims, list | tuple | range) else [dims]
    wanted = tuple(
        dict.fromkeys(as_integer("dims", d, least=1, most=_SETTINGS.most_dims) for d in listed)
    )
    asked = tuple(sorted({as_integer("counts", n, least=1) for n in counts}))
    many = as_integer("realizations", realizations, least=2)
    seed = as_integer("rng", rng, least=0)
    if not samplers or len(asked) < 2 or not wanted:
        raise ParameterError(
            f"Given: {counted(len(samplers), 'sampler')}, {counted(len(asked), 'count')} and "
            f"{counted(len(wanted), 'choice')} of dims; give at least one sampler, two counts and "
            "one number of dims."
        )

    # Make each sampler in all dims that it allows
    made = list[tuple[str, dict[int, Sampler]]]()
    for given in samplers:
        sources: dict[int, Sampler] = {}
        reason: McspectraError | None = None
        whole = given if isinstance(given, str) else as_sampler(given)
        for d in wanted:
            try:
                sources[d] = shared_sets(as_sampler(whole, d))
            except McspectraError as error:
                reason = reason or error
        if reason is not None and not sources:
            raise reason
        # Skip dims in which a sampler allows only one of the requested counts.
        # In 10-D, for example, strata allow few numbers of points
        single = [d for d, each in sources.items() if len(_nearest(each, asked)) < 2]
        for d in single if len(single) < len(sources) else ():
            del sources[d]
        made.append((whole if isinstance(whole, str) else whole.spec, sources))
    specs = [spec for spec, _ in made]
    for spec in specs:
        if specs.count(spec) > 1:
            raise ParameterError(
                f"The sampler {short_spec(spec)} is listed twice; list each sampler once."
            )
    labels = list(map(short_spec, specs))
    if len(set(labels)) < len(labels):  # Files in several folders may have equal names
        labels = specs

    tasks = [task for d in wanted for task in standard_tasks(d)]
    titles = [task.title for task in tasks]
    measured, notes, applied = [], list[str](), list[str]()
    for k, (label, (spec, sources)) in enumerate(zip(labels, made, strict=True)):
        report("bench", k / len(made))
        added = dict[str, None]()
        own = np.random.SeedSequence([seed, zlib.crc32(spec.encode())])
        parts = [_look(sources[wanted[0]], asked, own, seed)] if wanted[0] in sources else []
        for d, source in sources.items():
            made_counts = sorted(set(_nearest(source, asked).values()))
            free, step = free_of(source, made_counts)
            if not step:  # A sampler that is a function may ignore the random generator
                n = made_counts[-1]
                if different_realizations(source, n, Stream.from_rng(own), 2) == 1:
                    free, step = randomized(source, made_counts)
            if step and step not in added:
                notes.append(
                    f"{label} has too few different sets: its variances are measured with "
                    f"{short_spec(free.spec)}"
                )
            added |= {step: None} if step else {}
            # Measure convergence on the integrands, with allowed counts near the requested counts
            nearest, own_tasks = _nearest(free, asked), [t for t in tasks if t.dims == d]
            numbers, sets = sorted({*nearest.values()}), many
            if isinstance(free, GivenPoints):
                sets = min(many, *(len(free.sets[n]) for n in numbers))
            estimators = [Estimator(task.spec, dims=d) for task in own_tasks]
            curves = convergence(estimators, free, numbers, realizations=sets, rng=own)
            curves = curves[["mean", "variance", "variance_ci", "rate", "rate_ci"]]
            curves = curves.rename(estimator="integrand").assign_coords(
                integrand=[task.title for task in own_tasks], n=list(nearest)
            )
            points = np.broadcast_to(np.array(numbers, float), (len(own_tasks), len(numbers)))
            parts.append(curves.merge(dataset({"points_made": (("integrand", "n"), points)})))
        if lacking := [f"{d}-D" for d in wanted if d not in sources]:
            notes.append(f"{label} does not allow {' and '.join(lacking)}")
        most = sources[max(sources)]
        one = most.draw(most.nearest_count(min(asked[-1], _SETTINGS.most_pictured)), rng=seed)[0]
        at = {"point": range(len(one)), "axis": range(most.dims)}
        parts.append(dataset({"points": (("point", "axis"), one)}, {**at, "integrand": titles}))
        measured.append(_joined(parts))
        applied.append(", ".join(added))
    report("bench", 1.0)

    # Combine the results of all samplers on common coordinates, then compute ranks
    import xarray as xr

    found = xr.concat(
        measured,
        "sampler",
        join="outer",
        coords="minimal",
        compat="override",
        combine_attrs="override",
    )
    found = found.reindex(integrand=titles)
    found = found.assign_coords(
        sampler=[spec for spec, _ in made],
        label=("sampler", labels),
        randomization=("sampler", applied),
        integrand_spec=("integrand", [task.spec for task in tasks]),
        integrand_dims=("integrand", [task.dims for task in tasks]),
    )
    last = found.isel(n=-1)
    rank, rank_ci = ranks(
        *(last[name].values for name in ("variance", "variance_ci", "points_made"))
    )
    places = ("sampler", "integrand")
    about = dataset(
        {"rank": (places, rank), "rank_ci": ((*places, "bound"), rank_ci)},
        {"bound": ["low", "high"]},
        dims=list(wanted),
        realizations=many,
        seed=seed,
        note="; ".join(notes) or None,
    )
    found = found.merge(about, compat="override")
    found.attrs = about.attrs
    return found


def ranks(variance: Array, variance_ci: Array, n: Array) -> tuple[Array, Array]:
    """Return ranks of samplers by n · variance, and simultaneous 95 % intervals of all ranks.

    Parameters
    ----------
    variance, variance_ci, n
        Arrays (sampler, task), with 95 % intervals (sampler, task, 2); NaN for a missing result.

    Returns
    -------
    tuple
        Ranks (sampler, task), where rank 1 has the least variance.
        The 95 % intervals of ranks have the shape (sampler, task, 2).
        The lower end of an interval is one more than the number of significantly better samplers.
        The test compares independent estimates of log variance.
        The test uses the Bonferroni correction over all pairs of samplers on all tasks.
    """
    from scipy.special import ndtri

    known = (variance >= 0.0) & np.isfinite(variance)
    with np.errstate(divide="ignore", invalid="ignore"):
        logs = np.where(known, np.log(n * variance), np.nan)
        steps = np.abs(np.log(variance_ci / variance[..., None])) / ndtri(0.975)
    steps = np.where((variance == 0.0)[..., None], 0.0, steps)
    pairs = sum(math.comb(int(k), 2) for k in known.sum(axis=0))
    z = ndtri(1.0 - (1.0 - _LEVEL) / (2.0 * max(pairs, 1)))

    # Sampler i is significantly better than k if the intervals of their variances do not overlap
    with np.errstate(invalid="ignore"):
        gap = logs[None] - logs[:, None]
        sure = gap > z * np.hypot(steps[:, None, :, 1], steps[None, ..., 0])
    ends = np.stack([1.0 + sure.sum(axis=0), known.sum(axis=0) - sure.sum(axis=1)], axis=-1)
    rank = 1.0 + (gap < 0.0).sum(axis=1)
    return np.where(known, rank, np.nan), np.where(known[..., None], ends, np.nan)


def standard_tasks(dims: int) -> Iterator[Task]:
    """Yield the standard integrands in a number of dims."""
    for family, difficulty in _GENZ.items():
        if family != "discontinuous" or dims > 1:
            spec = f"genz-{family}(a={difficulty / dims:.4g})"
            yield Task(_KINDS.get(family, "smooth"), spec, dims)
    normal = [round(1.0 / (1.0 + 0.3 * i), 4) for i in range(dims)]
    yield Task("jump", f"half-space(normal={normal}, offset={0.5 * sum(normal):.5g})", dims)
    if dims in (2, 3):
        yield Task("jump", "disk(center=0.47, radius=0.3)", dims)


def _nearest(source: Sampler, asked: Sequence[int]) -> dict[int, int]:
    """Return the allowed counts of a sampler nearest to the requested counts, each count once."""
    found = {n: source.nearest_count(n) for n in asked}
    best = {count: min(asked, key=lambda n: abs(n - count)) for count in found.values()}
    return {n: count for n, count in found.items() if best[count] == n}


def _look(source: Sampler, asked: Sequence[int], own: Any, seed: int) -> xr.Dataset:
    """Compute the spectrum, pair correlation, quality and speed of a sampler."""
    stream = Stream.from_rng(own)
    nearest = _nearest(source, asked)
    n = max(nearest.values())
    slow = isinstance(source.plain, OptimisedSampler)
    sets = different_realizations(source, n, stream, SHARED_SETS if slow else 100)
    parts = []
    known: dict[str, tuple[tuple[str, ...], Any]] = {"pictured_n": ((), float(n))}
    if source.dims <= len(_SETTINGS.half_widths):
        wide = _SETTINGS.half_widths[source.dims - 1]
        spectrum = power_spectrum(source, n, half_width=wide, realizations=sets, rng=own)
        rings = radial_statistics(spectrum)[["anisotropy_db", "anisotropy_noise_db"]]
        parts += [spectrum[["power", "radial_power"]], rings]
        known["spectrum_sets"] = ((), float(sets))
    if n > 1:
        paired = min(sets, _SETTINGS.pair_sets)
        # All samplers have the same bins, although their counts may differ
        reach = min(0.5, _SETTINGS.pair_spacings * asked[-1] ** (-1.0 / source.dims))
        pairs = pair_correlation(source, n, realizations=paired, rng=own, max_distance=reach)
        known["pair_sets"] = ((), float(paired))
        if sets < _SETTINGS.few_sets:  # Wide intervals from few sets would hide the curve
            pairs["pair_correlation_ci"][:] = np.nan
        parts.append(pairs[["pair_correlation", "pair_correlation_ci"]])
    names = (*BENCH_QUALITY, "quality_sets", "points_per_second")
    means: dict[str, list[float]] = {name: [] for name in names}
    for count in nearest.values():
        some = different_realizations(source, count, stream, _SETTINGS.quality_sets)
        figures = quality_figures(source, count, figures=BENCH_QUALITY, realizations=some, rng=own)
        for name, values in figures.data_vars.items():
            means[str(name)].append(float(values.mean(skipna=False)))
        means["quality_sets"].append(float(some))
        means["points_per_second"].append(count / making_seconds(source, count, seed))
    known |= {k: (("n",), v) for k, v in means.items() if not np.isnan(v).all()}
    parts.append(dataset(known, {"n": list(nearest)}))
    return _joined(parts)


def _joined(parts: Sequence[xr.Dataset]) -> xr.Dataset:
    """Merge results of one sampler. Curves for several numbers of dims are concatenated."""
    import xarray as xr

    return xr.merge(parts, join="outer", compat="no_conflicts", combine_attrs="override")


def shared_sets(source: Sampler) -> Sampler:
    """Return a sampler that reuses a few sets of an optimized sampler."""
    if isinstance(source, OptimisedSampler):
        return replace(source, sets=source.sets or SHARED_SETS)
    if isinstance(source, Randomized) and isinstance(source.base, OptimisedSampler):
        return replace(source, base=shared_sets(source.base))
    return source


def free_of(source: Sampler, counts: Sequence[int]) -> tuple[Sampler, str]:
    """Return a sampler whose variance can be measured, and the name of an added randomization.

    If the sets of the sampler do not vary enough at the given counts, they are randomized.
    Without a randomization the name is empty.
    """
    few = (
        isinstance(source, GivenPoints)
        and min(map(len, source.sets.values())) < _SETTINGS.enough_sets
    )
    return randomized(source, counts) if source.fixed or few else (source, "")


def randomized(source: Sampler, counts: Sequence[int]) -> tuple[Sampler, str]:
    """Return the sampler with owen (nets) or shift (other sets), and the name of this step."""
    nets = bases_to_scramble([source.law(n) for n in counts]) is not None
    step = Owen() if nets else Shift()
    return source.then(step), step.name


def making_seconds(source: Sampler, n: int, rng: int) -> float:
    """Return the least time of a few draws on one thread without the cache, or NaN for files."""
    if isinstance(source.plain, GivenPoints):
        return math.nan
    stream = Stream.from_rng(rng)

    def draw(realization: int) -> Any:
        if isinstance(source, OptimisedSampler):
            return source._optimize(n, stream.keys(realization, 1)[0], lambda _: None)
        return source.draw_stream(n, stream, realization, 1)

    best = math.inf
    for realization in range(3):
        start = time.perf_counter()
        draw(realization)
        best = min(best, time.perf_counter() - start)
        if best > 1.0:
            break
    return best
