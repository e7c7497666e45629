"""Candidates: set-ups of an estimator and a sampler that differ from the given one in one respect.

A *kind* of change is a function that takes the given set-up and yields candidates.
Each candidate has a text that describes the change in the imperative.
A kind of change without candidates raises an error with the reason.
`candidates_of` yields the candidates of all requested kinds of change.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal, TypeAlias, final

from mcspectra.core.errors import McspectraError, ParameterError
from mcspectra.core.streams import Stream
from mcspectra.densities import (
    Bilinear,
    Defensive,
    EnvironmentDensity,
    ImageDensity,
    PiecewiseConstant,
    compensated,
)
from mcspectra.estimators import AbstractEstimator, Estimator, Mirrored, MultipleImportance
from mcspectra.estimators.base import Weighted
from mcspectra.estimators.channels import ChannelSampling
from mcspectra.estimators.heuristics import HEURISTICS, as_heuristic
from mcspectra.estimators.mirrored import MIRRORINGS
from mcspectra.explain.diagnosis import jumps_inside
from mcspectra.explain.samples import NETS
from mcspectra.improve.alignment import aligned, best_alignment
from mcspectra.improve.answers import Candidate
from mcspectra.improve.improved import (
    CHANGES,
    Cubic,
    Evaluations,
    Periodized,
    evaluated,
    improvements,
)
from mcspectra.improve.variants import smoothing_scan
from mcspectra.integrands.smoothing import BoxSmoothed, smoothed
from mcspectra.measure.setup import Setup, affordable_count
from mcspectra.samplers import Sampler, Shift, StrataShift
from mcspectra.samplers.law import PairedAxes, Strata
from mcspectra.samplers.registry import sampler as make_sampler
from mcspectra.samplers.stratified import root

__all__ = [
    "CANDIDATE_SETTINGS",
    "KINDS",
    "LATTICE",
    "Budget",
    "CandidateSettings",
    "Kind",
    "candidates_of",
]

LATTICE = "rank1-lattice | shift"
"""Shifted lattices, the points for a periodic g."""
# Number of the random stream for pilots. Streams 0 and 1 are for searches of widths and offsets
_PILOTS = 2
# A mirrored estimator contains another estimator. Kinds of change that apply to the inner one
_INSIDE = frozenset(
    {"smoothed", "warp", "heuristic", "techniques", "compensated", "channels", *CHANGES}
)


@final
@dataclass(frozen=True)
class CandidateSettings:
    """Settings that decide which changes of a set-up are tried."""

    # Samplers that are tried instead of the given one: the usual sampler of each family
    samplers: tuple[str, ...] = (
        "random",
        "jittered",
        "jittered | shift",
        "antithetic-jittered",
        "latin-hypercube",
        "halton | permute",
        LATTICE,
        f"{LATTICE} | mirror(mode='fold')",
        "sobol | owen",
    )
    # Maximum number of dims in which strata are aligned with edges.
    # An offset search computes 96 variances in 2-D, 112 in 3-D and 320 in 4-D.
    # In 3-D, 64 points have only four strata along each axis.
    most_aligned_dims: int = 2
    # Maximum number of dims in which cubic stratification is tried.
    # In 4-D, the order 4 of cubic stratification needs at least 4^4 = 256 cells.
    # In d dims, cubic stratification has the rate −1 − 8/d at best.
    # In 4-D, the rate −3 of cubic stratification is little better than the rate of nets.
    most_cubic_dims: int = 3
    # Order of the substitution of variables that makes a bounded g periodic. It is odd.
    # With 64 to 256 points in 2-D to 4-D, order 3 has less error than higher orders
    # (`benchmarks periodized`).
    order: int = 3
    # Order of the substitution if g grows without bound toward the border.
    # For (xy)^-0.4 and 256 points, the error is 1.5e-4 with order 3 and 2.3e-7 with order 6.
    order_of_growing: int = 6
    # Maximum number of dims in which `order_of_growing` is used.
    # In 4-D, 1,024 points have 180 times the error of order 3 for a product of lognormals.
    most_growing_dims: int = 3
    # Maximum number of dims in which g is made periodic.
    # In d dims, the substitution multiplies ∫g² by up to 1.5^d, so nets are better in many dims.
    # The test `benchmarks periodized` contains a smooth function in 5-D with 1,024 points.
    # For this function, the substitution gives 4 times the RMSE of a folded lattice.
    most_periodized_dims: int = 4
    # Maximum number of dims in which edges are smoothed by means over boxes.
    # In more dims, means over boxes take too many evaluations of f.
    # Smoothing by the distance to the edge takes one evaluation per point.
    most_boxed_dims: int = 2
    # A pilot takes the budget B divided by this number.
    # With a pilot of B/8, the budgets B/4 and B of `mcspectra.remedies` are larger than the pilot.
    # Two budgets are enough to measure a rate.
    pilot_divisor: int = 8
    # Least number of points of a pilot. Each half of the pilot has 32 points.
    # With 4 points per term (`RegressionSettings.evaluations_per_term`), 32 points fit 8 terms.
    least_pilot: int = 64
    # Maximum number of points of a pilot (`benchmarks improvements`).
    # For an Asian option in 16-D, regressions were fitted to 2048, 4096 and 8192 points.
    # With 2048 points, the regression leaves 1.08 % of the variance of the option.
    # With 4096 points, 0.93 % of the variance remains, and with 8192 points 0.89 %.
    # Variances of densities that are fitted with 2048 to 8192 points differ by only 3 %.
    most_pilot: int = 4096
    # Widths of smoothed edges that are tried: powers of two from 2^-10 to 1/4 of the domain.
    # Wider edges cover most of the domain; narrower edges act as jumps for usual budgets.
    widths: tuple[float, ...] = tuple(2.0**-k for k in range(10, 1, -1))
    # Maximum number of realizations for each variance in a scan over widths or over offsets.
    # With 300 realizations, the relative standard error of a variance is √(2/300) = 8 %.
    # An error of 8 % is small enough to choose between widths that differ by a factor of two.
    scan_realizations: int = 300


CANDIDATE_SETTINGS = CandidateSettings()
"""Default settings that decide which changes of a set-up are tried."""


@dataclass(frozen=True)
class Budget:
    """Evaluations, realizations and random numbers of a search for the best change."""

    evaluations: int  # number of evaluations of the integrand in one estimate
    realizations: int  # number of estimates of each measurement
    stream: Stream  # random numbers of the search, not reused afterwards
    settings: CandidateSettings = CANDIDATE_SETTINGS
    # Existing evaluations of g at uniform points; without them, each fit takes a pilot
    seen: Evaluations | None = None
    grows: bool | None = None  # whether g grows without bound toward the border, if known


_Candidates: TypeAlias = Iterator[Candidate | str]
"""Yielded candidates, and texts that explain why other changes were not tried."""

Kind: TypeAlias = Literal[
    "unshifted",
    "mirrored",
    "aligned",
    "smoothed",
    "warp",
    "fitted",
    "regression",
    "order",
    "preintegrated",
    "heuristic",
    "techniques",
    "compensated",
    "channels",
    "cubic",
    "periodized",
    "sampler",
]
"""Kinds of change, in the order in which they are tried."""


def candidates_of(given: Setup, kinds: Sequence[Kind], budget: Budget) -> _Candidates:
    """Yield each candidate of the given kinds once, and ``name: reason`` for untried changes.

    If a kind of change raises an error, the reason is the message of this error.
    If the estimator is mirrored, its inner estimator is changed, and the result is mirrored again.
    """
    seen = {Candidate("given", "given", "", given).key}
    for kind in kinds:
        own = given.estimator
        outer = own if isinstance(own, Mirrored) and kind in _INSIDE else None
        inner = given if outer is None else replace(given, estimator=outer.estimator)
        try:
            for found in KINDS[kind](inner, budget):
                if isinstance(found, str):
                    yield found
                    continue
                made, setup = found, found.setup
                try:
                    if outer is not None:
                        setup = replace(setup, estimator=Mirrored(setup.estimator, outer.mode))
                        made = replace(found, setup=setup)
                    # Raises an error if the sampler has no suitable points
                    setup.estimator.randomized(setup.sampler)
                except McspectraError as error:
                    yield f"{made.name}: {error}"
                    continue
                if made.key not in seen:
                    yield made
                seen.add(made.key)
        except McspectraError as error:
            yield f"{kind}: {error}"


def _candidate(
    given: Setup,
    kind: Kind,
    name: str,
    change: str,
    make: Callable[[], AbstractEstimator | Sampler | Setup],
    *,
    biased: bool = False,
) -> Candidate | str:
    """Return a candidate whose set-up `make` returns, or the reason why `make` failed."""
    try:
        made = make()
    except McspectraError as error:
        return f"{name}: {error}"
    if isinstance(made, AbstractEstimator):
        made = replace(given, estimator=made)
    setup = made if isinstance(made, Setup) else replace(given, sampler=made)
    return Candidate(kind, name, change, setup, biased)


def leave_shift_out(given: Setup, budget: Budget) -> _Candidates:  # noqa: ARG001
    """Yield the sampler without its shift."""
    plain = _without_shift(given.sampler)
    if plain is None:
        raise ParameterError(f"{given.sampler.spec} has no shift to leave out.")
    if not plain.unbiased:
        raise ParameterError(f"{plain.spec} is biased without its shift.")
    yield _candidate(given, "unshifted", "unshifted", "leave the shift out", lambda: plain)


def _without_shift(sampler: Sampler) -> Sampler | None:
    """Return the sampler without its shifts, or None if it has no shift."""
    plain, steps = sampler.plain, sampler.randomizations
    if not any(isinstance(step, Shift) for step in steps):
        return None
    for step in steps:
        plain = plain if isinstance(step, Shift) else plain.then(step)
    return plain


def align_strata(given: Setup, budget: Budget) -> _Candidates:
    """Yield strata with borders at known edges, and strata with the best offset at the budget."""
    plain = _without_shift(given.sampler) or given.sampler
    law = plain.law(plain.nearest_count(2**plain.dims))
    stratified = isinstance(law, Strata | PairedAxes)
    if not stratified or plain.dims > budget.settings.most_aligned_dims or not plain.unbiased:
        raise ParameterError(
            f"{plain.spec} has no strata in one or two dims that could be aligned."
        )

    def at_edges() -> Setup:
        """Move the borders of strata to the known discontinuities of g along the axes."""
        edges = [list(axis) for axis in given.estimator.primary_integrand(0).breaks]
        jittered = isinstance(law, Strata) and law.jittered
        if len(given.estimator.counts) > 1 or not any(edges) or not jittered:
            raise ParameterError("No edges along the axes are known.")
        at = partial(aligned, given.estimator, edges if plain.dims > 1 else edges[0])
        at(2**plain.dims)  # Raises an error if the estimator cannot be aligned
        return replace(given, sampler=plain, at_count=at)

    change = "bend the strata so that their borders are at the edges"
    yield _candidate(given, "aligned", "aligned with edges", change, at_edges)

    # Search for the best offset
    if given.is_black_box:
        yield "offset: Its search takes more evaluations than the budget."
        return
    n = affordable_count(replace(given, sampler=plain), budget.evaluations)
    if n is None:
        yield f"offset: {plain.spec} has no count within the budget."
        return
    found = best_alignment(
        given.estimator,
        plain,
        n,
        realizations=min(budget.realizations, budget.settings.scan_realizations),
        rng=budget.stream.generator(1),
        workers=1,
    )
    offset = found["strata_offset"].sel(candidate="offset").values.tolist()
    if not any(offset):
        yield "offset: No offset of the strata is better than none."
        return
    shown = ", ".join(f"{o:.3g}" for o in offset)
    step = StrataShift(offset=tuple(offset) if len(offset) > 1 else offset[0])
    change = f"move the strata by {shown} of their sides"
    yield _candidate(
        given, "aligned", f"strata moved by {shown}", change, partial(plain.then, step)
    )


def mirror(given: Setup, budget: Budget) -> _Candidates:  # noqa: ARG001
    """Yield the mirrored estimator, once for each way of mirroring."""
    if isinstance(given.estimator, Mirrored):
        raise ParameterError(f"{given.estimator.spec} is mirrored already.")
    changes = {
        "integrand": "spread the samples over the integrand's mirror images and fold them back",
        "random": "reflect every sample at random",
        "uniform": f"put each sample into all {1 << given.estimator.dims} mirror images",
    }
    for mode in MIRRORINGS:
        make = partial(Mirrored, given.estimator, mode)
        yield _candidate(given, "mirrored", f"mirrored: {mode}", changes[mode], make)


def change_sampler(given: Setup, budget: Budget) -> _Candidates:
    """Yield samplers of all families, and samplers of the renderer that computes g."""
    stock = getattr(getattr(given.estimator, "integrand", None), "stock_samplers", ())
    for spec in (*budget.settings.samplers, *stock):
        make = partial(make_sampler, spec, given.estimator.dims)
        yield _candidate(given, "sampler", spec, f"sample with {spec}", make)


def change_heuristic(given: Setup, budget: Budget) -> _Candidates:
    """Yield other heuristics for the weights of the techniques."""
    estimator = given.estimator
    if not isinstance(estimator, Weighted):
        raise ParameterError(f"{estimator.spec} has no heuristic: it is not weighted.")
    for name in HEURISTICS:
        make = partial(estimator.with_heuristic, name)
        pilot = as_heuristic(name).pilot_evaluations
        if pilot >= budget.evaluations:
            yield (
                f"heuristic: {name}: Its pilot alone takes {pilot} evaluations; the budget is "
                f"{budget.evaluations}."
            )
            continue
        change = f"combine the techniques by {as_heuristic(name).spec}"
        yield _candidate(given, "heuristic", f"heuristic: {name}", change, make)


def single_techniques(given: Setup, budget: Budget) -> _Candidates:  # noqa: ARG001
    """For each technique of the estimator, yield an estimator that uses only this technique."""
    estimator = given.estimator
    if not isinstance(estimator, Weighted) or len(estimator.counts) < 2:
        raise ParameterError(f"{estimator.spec} has one technique only.")
    for technique in range(len(estimator.counts)):
        make, name = partial(estimator.alone, technique), estimator.technique_name(technique)
        yield _candidate(given, "techniques", f"only {name}", f"sample {name} alone", make)


def compensate(given: Setup, budget: Budget) -> _Candidates:  # noqa: ARG001
    """Yield tabulated densities without the part that other techniques sample ([Karlik2019]_)."""
    estimator = given.estimator
    if not isinstance(estimator, MultipleImportance) or len(estimator.densities) < 2:
        raise ParameterError(f"{estimator.spec} has no table alongside other techniques.")

    def sharpened(technique: int) -> AbstractEstimator:
        order = sorted(range(len(estimator.counts)), key=lambda t: t != technique)
        densities, counts = list(estimator.densities), [estimator.counts[t] for t in order]
        own, *others = (densities[t] for t in order)
        if isinstance(own, EnvironmentDensity):
            densities[technique] = dataclasses.replace(own, compensation=True)
        else:
            densities[technique] = compensated(own, others, counts)
        f, heuristic = estimator.integrand, estimator.heuristic
        return MultipleImportance(
            f, densities, heuristic=heuristic, counts=estimator.counts, sets=estimator.sets
        )

    for technique, density in enumerate(estimator.densities):
        if isinstance(density, PiecewiseConstant | ImageDensity | EnvironmentDensity):
            name = f"the table of technique {technique}"
            change = f"leave out of {name} what the other techniques sample often enough"
            yield _candidate(
                given,
                "compensated",
                f"compensated: technique {technique}",
                change,
                partial(sharpened, technique),
            )


def change_warp(given: Setup, budget: Budget) -> _Candidates:  # noqa: ARG001
    """Yield other warps of the same density, other densities, and the uniform density."""
    estimator = given.estimator
    density = estimator.density if isinstance(estimator, Estimator) else None
    if not isinstance(estimator, Estimator) or density is None:
        raise ParameterError(f"{estimator.spec} has no single density to replace.")

    # List three changes: other warps of the same pdf, a pdf without jumps, a pdf bounded below
    plain: Any = density  # Only some densities have the parameters that are read below
    others = [dataclasses.replace(plain, warp=w) for w in density.warps if w != plain.warp]
    if isinstance(density, EnvironmentDensity) and density.interpolation == "constant":
        others.append(dataclasses.replace(density, interpolation="bilinear", warp="marginal"))
    if isinstance(density, PiecewiseConstant) and density.dims == 2:
        others.append(Bilinear(values=density.values))
    if not math.isfinite(density.reciprocal_integral()):
        others.append(Defensive(density=density))
    for other in others:
        make = partial(Estimator, estimator.integrand, other)
        yield _candidate(given, "warp", f"density: {other.spec}", f"warp by {other.spec}", make)
    change = "sample uniformly, without importance sampling"
    yield _candidate(
        given, "warp", "uniform density", change, partial(Estimator, estimator.integrand)
    )


def smooth_edges(given: Setup, budget: Budget) -> _Candidates:
    """Scan widths of smoothed edges; yield the width with the least error at the budget."""
    estimator = given.estimator
    n = affordable_count(given, budget.evaluations)
    if not isinstance(estimator, Estimator) or n is None:
        raise ParameterError(f"{estimator.spec} has no single f to smooth.")
    if given.is_black_box:
        raise ParameterError("The search for a width takes more evaluations than the budget.")
    if jumps_inside(estimator, given.sampler) is False:
        raise ParameterError("No jump inside was found, so there is nothing to smooth.")
    settings = budget.settings
    method = "distance" if estimator.dims > settings.most_boxed_dims else "auto"
    scan = smoothing_scan(
        estimator.integrand,
        given.sampler,
        n,
        settings.widths,
        density=estimator.density,
        method=method,
        realizations=min(budget.realizations, settings.scan_realizations),
        rng=budget.stream.generator(0),
        workers=1,
    )
    width = float(scan["best_width"].values[0])
    f = smoothed(estimator.integrand, width, method=method)
    biased = not isinstance(f, BoxSmoothed)  # Means over boxes do not change the integral
    change = f"smooth the edges of f over a width of {width:.3g}"
    make = partial(Estimator, f, estimator.density)
    yield _candidate(given, "smoothed", f"smoothed by {width:.3g}", change, make, biased=biased)


def separate_channels(given: Setup, budget: Budget) -> _Candidates:  # noqa: ARG001
    """Yield a density for each channel, and densities that combine channels."""
    estimator = given.estimator
    density: Any = estimator.density if isinstance(estimator, Estimator) else None
    parameters = set() if density is None else {f.name for f in dataclasses.fields(density)}
    if not estimator.channels or "channel" not in parameters:
        raise ParameterError(
            f"{estimator.spec} has no channels with a density of which one can be chosen."
        )
    assert isinstance(estimator, Estimator)
    f = estimator.integrand
    own = [dataclasses.replace(density, channel=c) for c in range(estimator.channels)]
    shared = "warp the same points by the density of each channel"
    combined = "combine the densities of all channels by multiple importance sampling"
    for name, change, make in (
        ("own", "sample each channel by its own density", partial(ChannelSampling, f, own)),
        ("shared", shared, partial(ChannelSampling, f, own, sets="shared")),
        ("combined", combined, partial(MultipleImportance, f, own)),
    ):
        yield _candidate(given, "channels", f"channels: {name}", change, make)


def improve(kind: Kind, given: Setup, budget: Budget) -> _Candidates:
    """Yield changes of g that are fitted to existing evaluations or to a pilot."""
    seen, charged = budget.seen, 0
    if seen is None:
        settings, each = budget.settings, given.estimator.evaluations_per_point
        count = min(budget.evaluations // settings.pilot_divisor, settings.most_pilot) // each
        if count < settings.least_pilot:
            raise ParameterError(
                f"A pilot of {max(count, 0)} points is too small; give a budget of at least "
                f"{settings.least_pilot * settings.pilot_divisor * each} evaluations."
            )
        stream = budget.stream.child(_PILOTS)
        seen = evaluated(given.estimator, count, stream, adapt=kind == "fitted")
        charged = given.overhead + count * each
    found = list(improvements(given, seen, [kind], charged=charged))
    if not found:
        raise ParameterError(f"{len(seen.points)} evaluations show no gain from it.")
    yield from found
    # Combine the change with the best sampler for the remaining variance.
    # If the given sampler is already the best sampler, no combination is needed
    nets = make_sampler(NETS, given.estimator.dims)
    if nets.spec != given.sampler.spec:
        for alone in found:
            yield replace(
                alone,
                name=f"{alone.name}, with {NETS}",
                change=f"{alone.change}, and sample with {NETS}",
                setup=replace(alone.setup, sampler=nets),
            )


def stratify_cubes(given: Setup, budget: Budget) -> _Candidates:
    """Yield cubic stratification ([Chopin2024]_) of orders 3 and 4.

    Orders 1 and 2 exist as samplers: ``jittered`` and ``antithetic-jittered``.
    """
    d, most = given.estimator.dims, budget.settings.most_cubic_dims
    if d > most:
        raise ParameterError(
            f"In {d} dims there are too many cubes for higher orders, which are used in 1 to "
            f"{most}."
        )

    def of_order(order: int) -> Setup:
        cubic, sampler = Cubic.of(given.estimator, order), make_sampler("jittered", d)
        return Setup(Estimator(cubic), sampler, lambda n: Estimator(cubic.in_cells(root(n, d))))

    for order in (3, 4):
        change = f"subtract polynomials of degree {order - 1} in the cells of jittered points"
        yield _candidate(given, "cubic", f"cubic: order {order}", change, partial(of_order, order))


def periodize(given: Setup, budget: Budget) -> _Candidates:
    """Yield substitutions that make g periodic, with a shifted lattice ([Sidi2006]_)."""
    d, most = given.estimator.dims, budget.settings.most_periodized_dims
    if d > most:
        raise ParameterError(
            f"In {d} dims the substitution adds too much variance; it is used in 1 to {most}."
        )

    usual, high = budget.settings.order, budget.settings.order_of_growing
    by_growth = {False: [usual], True: [high], None: [usual, high]}
    orders = [usual] if d > budget.settings.most_growing_dims else by_growth[budget.grows]
    for order in orders:
        changed = Periodized.of(given.estimator, order, budget.seen)
        name = "periodized" if len(orders) == 1 else f"periodized to order {order}"
        change = f"substitute φ' ∝ sin(πu)^{order - 1}, so that g is periodic, and use {LATTICE}"
        setup = Setup(Estimator(changed), make_sampler(LATTICE, d))
        yield Candidate("periodized", name, change, setup, finite_below=changed.finite_below)


KINDS: Mapping[Kind, Callable[[Setup, Budget], _Candidates]] = {
    "unshifted": leave_shift_out,
    "mirrored": mirror,
    "aligned": align_strata,
    "smoothed": smooth_edges,
    "warp": change_warp,
    "fitted": partial(improve, "fitted"),
    "regression": partial(improve, "regression"),
    "order": partial(improve, "order"),
    "preintegrated": partial(improve, "preintegrated"),
    "heuristic": change_heuristic,
    "techniques": single_techniques,
    "compensated": compensate,
    "channels": separate_channels,
    "cubic": stratify_cubes,
    "periodized": periodize,
    "sampler": change_sampler,
}
"""Kinds of change, with the functions that yield the changes."""
