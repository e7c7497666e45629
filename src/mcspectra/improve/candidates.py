"""What else could have been done: an estimator and a sampler, changed in one respect each.

A *kind* of change is a function from the set-up that is given to offers, each with the imperative
that says how; where it has nothing to offer, it raises the reason. `other_setups` makes the
set-ups.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal, TypeAlias

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
from mcspectra.improve.alignment import aligned, best_alignment
from mcspectra.improve.improved import CHANGES, Cubic, evaluated, improvements
from mcspectra.improve.variants import smoothing_scan
from mcspectra.integrands.smoothing import BoxSmoothed, smoothed
from mcspectra.measure.setup import Setup, affordable_count
from mcspectra.samplers import Jittered, Sampler, Shift, StrataShift
from mcspectra.samplers.base import Structure
from mcspectra.samplers.registry import sampler as make_sampler
from mcspectra.samplers.stratified import root

__all__ = [
    "KINDS",
    "Budget",
    "Counterfactual",
    "Kind",
    "other_setups",
]

_SAMPLERS = (
    "random",
    "jittered",
    "jittered | shift",
    "antithetic-jittered",
    "latin-hypercube",
    "halton | permute",
    "rank1-lattice | shift",
    "sobol | owen",
)
_MOST_ALIGNED = 2
_MOST_CUBIC = 3  # dims
_MOST_BOXED = 2  # dims, in which edges are smoothed by means over boxes
_PILOT = 8  # it takes one part in so many of the budget, so that the last two of the steps can be measured
_LEAST_PILOT, _MOST_PILOT = 64, 4096
_PILOTS = 2  # stream label, after those of the searches
_INSIDE = frozenset(
    {"smoothed", "warp", "heuristic", "techniques", "compensated", "channels", *CHANGES}
)
_WIDTHS = tuple(2.0**-k for k in range(10, 1, -1))
_SCAN_REALIZATIONS = 300


@dataclass(frozen=True)
class Budget:
    """What searches for the best of a family may use."""

    evaluations: int  # of the integrand, in an estimate
    realizations: int  # estimates to measure with
    stream: Stream  # random numbers of their own: what was chosen is measured again on others


@dataclass(frozen=True)
class Counterfactual:
    """A set-up that differs from the one given in one respect."""

    kind: str  # one of `KINDS`, or ``"given"``
    name: str  # short label, unique among those compared
    change: str  # what to do, as an imperative
    setup: Setup  # the changed set-up
    # Whether it estimates something else, so that the error is taken about the given integral
    biased: bool = False

    @property
    def key(self) -> str:
        """The same for changes that make the same set-up."""
        specs = f"{self.setup.estimator.spec} with {self.setup.sampler.spec}"
        return specs if self.setup.at_count is None else f"{specs}, {self.name}"


@dataclass(frozen=True)
class _Offer:
    """A change that a kind has to offer."""

    name: str
    change: str  # as an imperative
    make: Callable[[], AbstractEstimator | Sampler | Setup]  # may fail
    biased: bool = False


_Offers: TypeAlias = Iterator[_Offer | str]
"""Offers, and sentences that name changes that could not be made, or would change nothing, and say why."""

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
    "sampler",
]
"""Kinds of change, in the order in which they are tried."""


def other_setups(
    given: Setup, kinds: Sequence[Kind], budget: Budget
) -> Iterator[Counterfactual | str]:
    """All set-ups of the kinds asked for, in the order of `kinds`, none twice; ``name: reason`` of others.

    Where a kind fails, that is its reason. Changes of what is inside of a mirrored estimator are
    mirrored again.
    """
    seen = {Counterfactual("given", "given", "", given).key}
    for kind in kinds:
        own = given.estimator
        outer = own if isinstance(own, Mirrored) and kind in _INSIDE else None
        inner = given if outer is None else replace(given, estimator=outer.estimator)
        try:
            for offer in KINDS[kind](inner, budget):
                if isinstance(offer, str):
                    yield offer
                    continue
                try:
                    made = offer.make()
                    if isinstance(made, AbstractEstimator):
                        made = replace(inner, estimator=made)
                    setup = made if isinstance(made, Setup) else replace(inner, sampler=made)
                    if outer is not None:
                        setup = replace(setup, estimator=Mirrored(setup.estimator, outer.mode))
                    # Raises where there are no such points
                    setup.estimator.randomized(setup.sampler)
                except McspectraError as error:
                    yield f"{offer.name}: {error}"
                    continue
                found = Counterfactual(kind, offer.name, offer.change, setup, offer.biased)
                if found.key not in seen:
                    yield found
                seen.add(found.key)
        except McspectraError as error:
            yield f"{kind}: {error}"


def leave_shift_out(given: Setup, budget: Budget) -> _Offers:  # noqa: ARG001
    """The sampler without its shift."""
    plain = _without_shift(given.sampler)
    if plain is None:
        raise ParameterError(f"{given.sampler.spec} has no shift to leave out.")
    if not plain.unbiased:
        raise ParameterError(f"{plain.spec} is biased without its shift.")
    yield _Offer("unshifted", "leave the shift out", lambda: plain)


def _without_shift(sampler: Sampler) -> Sampler | None:
    """The sampler without its shifts; None where it has none."""
    plain, steps = sampler.plain, sampler.randomizations
    if not any(isinstance(step, Shift) for step in steps):
        return None
    for step in steps:
        plain = plain if isinstance(step, Shift) else plain.then(step)
    return plain


def align_strata(given: Setup, budget: Budget) -> _Offers:
    """The offset of strata that is best at the budget, and strata with borders at known edges."""
    plain = _without_shift(given.sampler) or given.sampler
    if plain.structure is not Structure.STRATA or plain.dims > _MOST_ALIGNED or not plain.unbiased:
        raise ParameterError(
            f"{plain.spec} has no strata in one or two dims that could be aligned."
        )

    def at_edges() -> Setup:
        """Borders at the breaks that g is known to have."""
        edges = [list(axis) for axis in given.estimator.primary_integrand(0).breaks]
        if len(given.estimator.counts) > 1 or not any(edges) or not isinstance(plain, Jittered):
            raise ParameterError("No edges along the axes are known.")
        at = partial(aligned, given.estimator, edges if plain.dims > 1 else edges[0])
        at(2**plain.dims)  # raises where that cannot be
        return replace(given, sampler=plain, at_count=at)

    change = "bend the strata so that their borders are at the edges"
    yield _Offer("aligned with edges", change, at_edges)

    # The best offset
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
        realizations=min(budget.realizations, _SCAN_REALIZATIONS),
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
    yield _Offer(f"strata moved by {shown}", change, partial(plain.then, step))


def mirror(given: Setup, budget: Budget) -> _Offers:  # noqa: ARG001
    """All ways of mirroring."""
    if isinstance(given.estimator, Mirrored):
        raise ParameterError(f"{given.estimator.spec} is mirrored already.")
    changes = {
        "integrand": "spread the samples over the integrand's mirror images and fold them back",
        "random": "reflect every sample at random",
        "uniform": f"put each sample into all {1 << given.estimator.dims} mirror images",
    }
    for mode in MIRRORINGS:
        make = partial(Mirrored, given.estimator, mode)
        yield _Offer(f"mirrored: {mode}", changes[mode], make)


def change_sampler(given: Setup, budget: Budget) -> _Offers:  # noqa: ARG001
    """Samplers of all families."""
    for spec in _SAMPLERS:
        make = partial(make_sampler, spec, given.estimator.dims)
        yield _Offer(spec, f"sample with {spec}", make)


def change_heuristic(given: Setup, budget: Budget) -> _Offers:
    """Other heuristics for the techniques."""
    estimator = given.estimator
    if not isinstance(estimator, Weighted):
        raise ParameterError(f"{estimator.spec} has no heuristic: it is not weighted.")
    for name in HEURISTICS:
        make = partial(estimator.with_heuristic, name)
        pilot = as_heuristic(name).pilot_evaluations
        if pilot >= budget.evaluations:
            yield (
                f"heuristic: {name}: Its pilot alone takes {pilot} evaluations, {budget.evaluations} "
                "are the budget."
            )
            continue
        change = f"combine the techniques by {as_heuristic(name).spec}"
        yield _Offer(f"heuristic: {name}", change, make)


def single_techniques(given: Setup, budget: Budget) -> _Offers:  # noqa: ARG001
    """Each technique alone."""
    estimator = given.estimator
    if not isinstance(estimator, Weighted) or len(estimator.counts) < 2:
        raise ParameterError(f"{estimator.spec} has one technique only.")
    for technique in range(len(estimator.counts)):
        make, name = partial(estimator.alone, technique), estimator.technique_name(technique)
        yield _Offer(f"only {name}", f"sample {name} alone", make)


def compensate(given: Setup, budget: Budget) -> _Offers:  # noqa: ARG001
    """Tables less what the other techniques sample ([Karlik2019]_)."""
    estimator = given.estimator
    if not isinstance(estimator, MultipleImportance) or len(estimator.densities) < 2:
        raise ParameterError(f"{estimator.spec} has no table beside other techniques.")

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
            yield _Offer(
                f"compensated: technique {technique}", change, partial(sharpened, technique)
            )


def change_warp(given: Setup, budget: Budget) -> _Offers:  # noqa: ARG001
    """Other densities, the same by other warps, and none."""
    estimator = given.estimator
    density = estimator.density if isinstance(estimator, Estimator) else None
    if not isinstance(estimator, Estimator) or density is None:
        raise ParameterError(f"{estimator.spec} has no single density to replace.")

    # The same pdf by other warps, one without its jumps, and one that is bounded from below
    plain: Any = density  # the parameters looked for are those of some densities only
    others = [dataclasses.replace(plain, warp=w) for w in density.warps if w != plain.warp]
    if isinstance(density, EnvironmentDensity) and density.interpolation == "constant":
        others.append(dataclasses.replace(density, interpolation="bilinear", warp="marginal"))
    if isinstance(density, PiecewiseConstant) and density.dims == 2:
        others.append(Bilinear(values=density.values))
    if not math.isfinite(density.reciprocal_integral()):
        others.append(Defensive(density=density))
    for other in others:
        make = partial(Estimator, estimator.integrand, other)
        yield _Offer(f"density: {other.spec}", f"warp by {other.spec}", make)
    change = "sample uniformly, without importance sampling"
    yield _Offer("uniform density", change, partial(Estimator, estimator.integrand))


def smooth_edges(given: Setup, budget: Budget) -> _Offers:
    """The width with the least error at the budget, found by a scan on random numbers of its own."""
    estimator = given.estimator
    n = affordable_count(given, budget.evaluations)
    if not isinstance(estimator, Estimator) or n is None:
        raise ParameterError(f"{estimator.spec} has no single f to smooth.")
    if given.is_black_box:
        raise ParameterError("The search for a width takes more evaluations than the budget.")
    if jumps_inside(estimator, given.sampler) is False:
        raise ParameterError("No jump inside was found that could be smoothed.")
    method = "distance" if estimator.dims > _MOST_BOXED else "auto"
    scan = smoothing_scan(
        estimator.integrand,
        given.sampler,
        n,
        _WIDTHS,
        density=estimator.density,
        method=method,
        realizations=min(budget.realizations, _SCAN_REALIZATIONS),
        rng=budget.stream.generator(0),
        workers=1,
    )
    width = float(scan["best_width"].values[0])
    f = smoothed(estimator.integrand, width, method=method)
    biased = not isinstance(f, BoxSmoothed)  # means over boxes keep the integral
    change = f"smooth the edges of f over a width of {width:.3g}"
    make = partial(Estimator, f, estimator.density)
    yield _Offer(f"smoothed by {width:.3g}", change, make, biased)


def separate_channels(given: Setup, budget: Budget) -> _Offers:  # noqa: ARG001
    """Densities for each channel."""
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
        yield _Offer(f"channels: {name}", change, make)


def improve(kind: str, given: Setup, budget: Budget) -> _Offers:
    """Changes of g that a pilot suggests, which is a small part of the budget and counts as such."""
    count = min(budget.evaluations // _PILOT, _MOST_PILOT)
    count //= given.estimator.evaluations_per_point
    if count < _LEAST_PILOT:
        raise ParameterError(
            f"A pilot of {max(count, 0)} points tells too little; give a budget of at least "
            f"{_LEAST_PILOT * _PILOT * given.estimator.evaluations_per_point} evaluations."
        )
    stream = budget.stream.child(_PILOTS)
    seen = evaluated(given.estimator, count, stream, adapt=kind == "fitted")
    charged = given.overhead + count * given.estimator.evaluations_per_point
    found = list(improvements(given.estimator, seen, [kind], charged=charged))
    if not found:
        raise ParameterError(f"{count} evaluations of a pilot show no gain by it.")
    for made in found:
        yield _Offer(made.name, made.change, lambda e=made.estimator: e)  # type: ignore[misc]


def stratify_cubes(given: Setup, budget: Budget) -> _Offers:  # noqa: ARG001
    """Cubic stratification ([Chopin2024]_) of orders 3 and 4; of 1 and 2 it is samplers: jittered ones."""
    d = given.estimator.dims
    if d > _MOST_CUBIC:
        raise ParameterError(
            f"In {d} dims cubes are too many for higher orders, which are tried in 1 to {_MOST_CUBIC}."
        )

    def of_order(order: int) -> Setup:
        cubic, sampler = Cubic.of(given.estimator, order), make_sampler("jittered", d)
        return Setup(Estimator(cubic), sampler, lambda n: Estimator(cubic.in_cells(root(n, d))))

    for order in (3, 4):
        change = f"subtract polynomials of degree {order - 1} in the cells of jittered points"
        yield _Offer(f"cubic: order {order}", change, partial(of_order, order))


KINDS: Mapping[Kind, Callable[[Setup, Budget], _Offers]] = {
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
    "sampler": change_sampler,
}
"""What makes the changes of each kind."""
