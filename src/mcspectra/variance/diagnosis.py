"""Why a set-up is as noisy as it is, and why a change to it helps: from what was looked at only.

Looked for are weights 1/p without bound, a technique of the slowest rate, what of the primary-space
integrand g is odd about the centre of the cube, and jumps of g, inside and between opposite faces of the cube, which samplers that wrap
around see. What was not looked at, as jumps in more than two dims, is not said to be absent.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from mcspectra.core.errors import McspectraError
from mcspectra.core.parallel import realization_blocks
from mcspectra.core.streams import Stream
from mcspectra.core.tally import counting
from mcspectra.estimators import AbstractEstimator, Mirrored, Moments
from mcspectra.estimators.mirrored import SymmetrizedIntegrand
from mcspectra.estimators.support import probe_points
from mcspectra.samplers import Sampler, Shift
from mcspectra.spectra.bases import parts_of
from mcspectra.variance.fit import UNRESOLVED, is_resolved
from mcspectra.variance.primary import primary_picture
from mcspectra.variance.techniques import UNDECIDED, technique_estimates, technique_rates

__all__ = ["Diagnosis", "Jumps", "diagnose", "jumps_of"]

_RESOLUTION = 128
_REALIZATIONS = 500
_MOSTLY, _FEW = 0.9, 0.1  # shares of the variance that are the reason, or one of several
_ODD_DIMS, _ODD_POINTS = 4, 2**12
_FEWER = 0.9  # of the length of jumps: less is a reason


@dataclass(frozen=True)
class Jumps:
    """Jumps of g of one kind: length of their curves (number in 1-D) and mean height."""

    length: float
    height: float
    dims: int

    def __bool__(self) -> bool:
        """Whether there are any."""
        return self.length > 0

    @property
    def text(self) -> str:
        """``along curves of length 1.2, by 0.5 on average``, or ``at 2 places`` in 1-D."""
        height = f"{self.height:.3g}" if math.isfinite(self.height) else "an unbounded height"
        if self.dims == 1:
            count = round(self.length)
            return f"at {count} place{'s' * (count > 1)}, by {height} on average"
        return f"along curves of length {self.length:.3g}, by {height} on average"


@dataclass(frozen=True)
class Diagnosis:
    """What was found about a set-up."""

    wraps: bool  # whether the sampler shifts points around the torus
    unbounded: bool  # whether ∫1/p diverges
    # The technique whose rate is slower than all others'; None where none is known to be
    slow: int | None
    slow_name: str  # its density or integrand, where it has one
    # Jumps of g, of all techniques together; None where they were not looked for
    boundary: Jumps | None
    inside: Jumps | None
    # Share of the variance of g that its mean over all reflections lacks; None where not looked for
    odd: float | None = None

    @property
    def text(self) -> str:
        """What costs precision, in sentences."""
        found = []
        if self.unbounded:
            found.append(
                "1/p is unbounded: ∫1/p diverges, and where f does not vanish with p rare samples "
                "get large weights."
            )
        if self.slow is not None:
            name = f" ({self.slow_name})" if self.slow_name else ""
            found.append(
                f"Technique {self.slow}{name} has the slowest rate, which becomes that of the sum."
            )
        if self.boundary is None or self.inside is None:
            unseen = "Jumps of g are looked for in 1 and 2 dims only, and within the budget."
            return " ".join([*found, unseen])
        jumps = []
        if self._wrapped_jump:
            jumps.append(
                f"g differs between opposite sides {self.boundary.text}, and the shift carries "
                "that jump into the strata."
            )
        if self.inside:
            jumps.append(f"g jumps inside {self.inside.text}.")
        return " ".join(
            [*found, *(jumps or ["No jump of g was found that the samples would see."])]
        )

    def reason(self, column: Mapping[str, Any]) -> str:
        """Why a change that was measured is better; what the measurement says where it is not."""
        if column["verdict"] == "given":
            return ""
        if column["blind"]:
            return "Its estimates are all alike and miss the integral: what is rare was not met."
        if column["verdict"] == "undecided":
            return "Its interval does not tell it from the set-up as given."
        if column["verdict"] == "worse":
            return f"Its {'mean squared error' if column['biased'] else 'variance'} is larger."

        # What a kind of change mends that was found; which property of a sampler it is, is not known
        name, wrapped = str(column["name"]), self._wrapped_jump
        inside: Jumps | None = column["inside"]
        odd = f"{100 * (self.odd or 0.0):.0f} % of the variance of g"
        uniform = name.endswith("uniform")
        match column["kind"]:
            case "mirrored" if uniform and (self.odd or 0.0) >= _MOSTLY:
                return f"g is odd about the centre ({odd}): the images of a sample cancel it."
            case "unshifted" if wrapped:
                return "Without the shift no stratum holds the jump between opposite sides."
            case "mirrored" if wrapped:
                return "Reflected, g is continuous across the sides, and wrap-around meets no jump."
            case "mirrored" if uniform and (self.odd or 0.0) >= _FEW:
                return f"The images of a sample cancel what is odd about the centre, {odd}."
            case "aligned" if self.inside:
                return "Borders of strata lie where g jumps, so that fewer strata hold a jump."
            case "aligned" if wrapped:
                return (
                    "Strata that stay where they are do not wrap around the jump between opposite "
                    "sides."
                )
            case "smoothed" if self.inside and column["biased"]:
                return "The jump inside becomes a ramp, for a bias that the mean squared error contains."
            case "smoothed" if self.inside:
                return "The jump inside becomes a ramp; means over boxes keep the integral."
            case "warp" if self.unbounded and not column["unbounded"]:
                return "Its 1/p is bounded."
            case "warp" if self.inside and inside is not None and not inside:
                return "Its g does not jump inside."
            case "warp" if (
                self.inside and inside is not None and inside.length < _FEWER * self.inside.length
            ):
                return f"Its g jumps less: {inside.text}."
            case "fitted":
                return "Its density is large where g is, as a pilot showed."
            case "regression":
                return "What polynomials explain of g has a known integral and is left out."
            case "order":
                return (
                    "The first coordinates, which sets sample best, are those that g varies with."
                )
            case "preintegrated":
                return "Its means are over the parts on both sides of the place where g jumps."
            case "cubic":
                return (
                    "What polynomials in each cube explain of g is left out, as far as g is smooth."
                )
            case "heuristic" if self.slow is not None:
                return f"It changes what technique {self.slow}, the slowest, contributes."
            case "techniques" if self.slow is not None and not name.endswith(self.slow_name):
                return f"It leaves out technique {self.slow}, the slowest."
            case "channels" if name.endswith("combined"):
                return "No channel is left to the samples of a density of another shape."
            case "channels":
                return "Each channel is divided by a density of its own shape."
        if math.isnan(column["rate"]):
            return ""
        if not is_resolved(*column["rate_ci"]):
            return f"Its rate is {UNRESOLVED}."
        if column["rate_verdict"] == "better":
            return f"Its rate is better, {column['rate']:.2f}."
        return "By how much its rate differs, the intervals leave open."

    @property
    def _wrapped_jump(self) -> bool:
        return self.wraps and bool(self.boundary)


def diagnose(
    estimator: AbstractEstimator,
    sampler: Sampler,
    counts: Sequence[int],
    stream: Stream,
    realizations: int = _REALIZATIONS,
    most: int | None = None,
) -> Diagnosis:
    """Look for the causes of noise; the rates of techniques are compared at ascending counts.

    Those of a user's function by so many realisations at most, and the rest by `most` evaluations of it.
    """
    with counting("The diagnosis", most):
        # Share of the variance of g that cancels in its mean over all 2^d reflections about the centre, from
        # means over fixed points; None in more than four dims, or where g is constant or has no values
        odd, whole, even = None, 0.0, 0.0
        with suppress(McspectraError):
            for t, count in enumerate(estimator.counts if estimator.dims <= _ODD_DIMS else ()):
                g, u = estimator.primary_integrand(t), probe_points(estimator.dims, _ODD_POINTS)
                whole += float(g(u).var(axis=0).sum()) / count
                even += float(SymmetrizedIntegrand(g)(u).var(axis=0).sum()) / count
            odd = max(1.0 - even / whole, 0.0) if whole > 0 else None
        boundary, inside = jumps_of(estimator)
    # What is mirrored is shifted before it is folded
    shifted = any(isinstance(step, Shift) for step in parts_of(sampler)[1])
    # The bottleneck among techniques, of all channels alike
    chosen: set[int] = set()
    if len(estimator.counts) > 1 and len(counts) > 1:
        moments, most = [], _REALIZATIONS
        if estimator.is_black_box:
            most = min(most, realizations)
        for n in counts:
            own, numbers = stream.child(n), n * estimator.dims * sum(estimator.counts)
            found = [
                Moments.of(technique_estimates(estimator, estimator.draw(sampler, n, own, *block)))
                for block in realization_blocks(most, numbers)
            ]
            moments.append(functools.reduce(Moments.merge, found))
        _, choice = technique_rates(counts, moments)
        chosen = {int(t) for t in choice} - {UNDECIDED}
    slow = chosen.pop() if len(chosen) == 1 else None
    named = getattr(estimator, "densities", None) or getattr(estimator, "integrands", None)
    return Diagnosis(
        wraps=shifted and not isinstance(estimator, Mirrored),
        unbounded=estimator.infinite_weights,
        slow=slow,
        slow_name="" if slow is None or named is None else named[slow].spec,
        boundary=boundary,
        inside=inside,
        odd=odd,
    )


def jumps_of(estimator: AbstractEstimator) -> tuple[Jumps | None, Jumps | None]:
    """Jumps of g at the boundary and inside, summed over techniques; None, None beyond two dims."""
    if estimator.dims > 2:
        return None, None
    try:
        pictures = [
            primary_picture(estimator, technique=t, resolution=_RESOLUTION)
            for t in range(len(estimator.counts))
        ]
    except McspectraError:  # g cannot be drawn, as where p is 0 between the samples
        return None, None
    found = []
    for kind in ("boundary", "interior"):
        lengths, heights = (
            [float(p[f"primary_jump_{name}"].sel(kind=kind)) for p in pictures]
            for name in ("length", "height")
        )
        total = sum(lengths)
        weighted = sum(k * h for k, h in zip(lengths, heights, strict=True) if k > 0)
        found.append(Jumps(total, weighted / total if total > 0 else 0.0, estimator.dims))
    return found[0], found[1]
