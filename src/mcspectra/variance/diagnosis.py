"""Why a set-up is as noisy as it is, and why a change to it helps: from what was looked at only.

Four causes are looked for: weights 1/p without bound; a technique whose rate is slower than those of
the others (`mcspectra.technique_terms`); jumps of the primary-space integrand g between opposite faces of
the cube, which samplers that wrap around see; and jumps inside (`mcspectra.primary_picture`). What was
not looked at, as jumps in more than two dims, is not said to be absent.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mcspectra.core.errors import McspectraError
from mcspectra.core.parallel import Block, map_in_order, realization_blocks
from mcspectra.core.streams import Stream
from mcspectra.estimators import AbstractEstimator, Mirrored, Moments
from mcspectra.samplers import Sampler, Shift
from mcspectra.samplers.base import Randomized
from mcspectra.variance.primary import primary_picture
from mcspectra.variance.techniques import UNDECIDED, technique_rates

__all__ = ["Diagnosis", "Jumps", "diagnose", "jumps_of"]

_RESOLUTION = 128
_REALIZATIONS = 500


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
    """What was found about a set-up.

    Attributes
    ----------
    wraps
        Whether the sampler shifts points around the torus.
    unbounded
        Whether ∫1/p diverges.
    slow
        The technique whose rate is slower than all others'; None where none is known to be.
    slow_name
        Its density or integrand, where it has one.
    boundary, inside
        Jumps of g, of all techniques together; None where they were not looked for.
    """

    wraps: bool
    unbounded: bool
    slow: int | None
    slow_name: str
    boundary: Jumps | None
    inside: Jumps | None

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
        return " ".join(found + self._about_jumps())

    def _about_jumps(self) -> list[str]:
        if self.boundary is None or self.inside is None:
            return ["Jumps of g are looked for in 1 and 2 dims only."]
        found = []
        if self.boundary and self.wraps:
            found.append(
                f"g differs between opposite sides {self.boundary.text}, and the shift carries "
                "that jump into the strata."
            )
        if self.inside:
            found.append(f"g jumps inside {self.inside.text}.")
        return found or ["No jump of g was found that the samples would see."]

    def reason(self, column: Mapping[str, Any]) -> str:
        """Why a change that was measured is better; what the measurement says where it is not."""
        if column["verdict"] == "given":
            return ""
        if column["blind"]:
            return "Its estimates are all alike and miss the integral: what is rare was not met."
        if column["verdict"] == "undecided":
            return "Its interval does not tell it from the set-up as given."
        if column["verdict"] == "worse":
            return "Its error is larger."
        reason = _REASONS[column["kind"]](self, column)
        return reason or _by_rate(column)

    @property
    def _wrapped_jump(self) -> bool:
        return self.wraps and bool(self.boundary)


def diagnose(
    estimator: AbstractEstimator, sampler: Sampler, counts: Sequence[int], stream: Stream
) -> Diagnosis:
    """Look for the causes of noise of an estimator with a sampler.

    Parameters
    ----------
    estimator, sampler
        The set-up.
    counts
        Ascending numbers of points at which the rates of techniques are compared.
    stream
        Random numbers for that.
    """
    boundary, inside = jumps_of(estimator)
    slow = _slowest(estimator, sampler, counts, stream)
    parts = getattr(estimator, "densities", None) or getattr(estimator, "integrands", None)
    return Diagnosis(
        wraps=_wraps(estimator, sampler),
        unbounded=estimator.infinite_weights,
        slow=slow,
        slow_name="" if slow is None or parts is None else parts[slow].spec,
        boundary=boundary,
        inside=inside,
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
    boundary, inside = (
        _summed([p.sel(kind=kind) for p in pictures], estimator.dims)
        for kind in ("boundary", "interior")
    )
    return boundary, inside


def _summed(pictures: list[Any], dims: int) -> Jumps:
    lengths = [float(p["primary_jump_length"]) for p in pictures]
    heights = [float(p["primary_jump_height"]) for p in pictures]
    total = sum(lengths)
    weighted = sum(length * h for length, h in zip(lengths, heights, strict=True) if length > 0)
    return Jumps(total, weighted / total if total > 0 else 0.0, dims)


def _wraps(estimator: AbstractEstimator, sampler: Sampler) -> bool:
    """Whether points are shifted; what is mirrored is shifted before it is folded."""
    steps = sampler.steps if isinstance(sampler, Randomized) else ()
    return any(isinstance(step, Shift) for step in steps) and not isinstance(estimator, Mirrored)


def _slowest(
    estimator: AbstractEstimator, sampler: Sampler, counts: Sequence[int], stream: Stream
) -> int | None:
    """The bottleneck among techniques, of all channels alike; None where it is not decided."""
    if len(estimator.counts) < 2 or len(counts) < 2:
        return None
    moments = [
        _technique_moments(estimator, sampler, n, _REALIZATIONS, stream.child(n)) for n in counts
    ]
    _, choice = technique_rates(list(counts), moments, len(counts))
    chosen = set(choice) - {UNDECIDED}
    return int(chosen.pop()) if len(chosen) == 1 else None


def _by_rate(column: Mapping[str, Any]) -> str:
    if math.isnan(column["rate"]):
        return ""
    if column["rate_verdict"] == "better":
        return f"Its rate is better, {column['rate']:.2f}."
    return "By how much its rate differs, the intervals leave open."


def _why_unshifted(diagnosis: Diagnosis, column: Mapping[str, Any]) -> str:
    del column
    wrapped = "Without the shift no stratum holds the jump between opposite sides."
    return wrapped if diagnosis._wrapped_jump else ""


def _why_mirrored(diagnosis: Diagnosis, column: Mapping[str, Any]) -> str:
    if diagnosis._wrapped_jump:
        return "Reflected, g is continuous across the sides, and wrap-around meets no jump."
    if column["name"].endswith("uniform"):
        return "The images of a sample are antithetic: what is odd in g cancels."
    return ""


def _why_aligned(diagnosis: Diagnosis, column: Mapping[str, Any]) -> str:
    del column
    if diagnosis.inside:
        return "Borders of strata lie where g jumps, so that fewer strata hold a jump."
    wrapped = "Strata that stay where they are do not wrap around the jump between opposite sides."
    return wrapped if diagnosis._wrapped_jump else ""


def _why_smoothed(diagnosis: Diagnosis, column: Mapping[str, Any]) -> str:
    if not diagnosis.inside:
        return ""
    if column["biased"]:
        return "The jump inside becomes a ramp, for a bias that the error contains."
    return "The jump inside becomes a ramp; means over boxes keep the integral."


def _why_warped(diagnosis: Diagnosis, column: Mapping[str, Any]) -> str:
    if diagnosis.unbounded and not column["unbounded"]:
        return "Its 1/p is bounded."
    inside: Jumps | None = column["inside"]
    if diagnosis.inside and inside is not None and inside.length < 0.9 * diagnosis.inside.length:
        if not inside:
            return "Its g does not jump inside."
        return f"Its g jumps less: {inside.text}."
    return ""


def _why_combined(diagnosis: Diagnosis, column: Mapping[str, Any]) -> str:
    del column
    if diagnosis.slow is None:
        return ""
    return f"It changes what technique {diagnosis.slow}, the slowest, contributes."


def _why_alone(diagnosis: Diagnosis, column: Mapping[str, Any]) -> str:
    slow = diagnosis.slow
    if slow is None or column["name"].endswith(diagnosis.slow_name):
        return ""
    return f"It leaves out technique {slow}, the slowest."


def _why_channels(diagnosis: Diagnosis, column: Mapping[str, Any]) -> str:
    del diagnosis
    if column["name"].endswith("combined"):
        return "No channel is left to the samples of a density of another shape."
    return "Each channel is divided by a density of its own shape."


def _why_sampler(diagnosis: Diagnosis, column: Mapping[str, Any]) -> str:
    del diagnosis, column
    return ""  # which of a sampler's properties it is has not been looked at


_REASONS = {
    "unshifted": _why_unshifted,
    "mirrored": _why_mirrored,
    "aligned": _why_aligned,
    "smoothed": _why_smoothed,
    "warp": _why_warped,
    "heuristic": _why_combined,
    "techniques": _why_alone,
    "channels": _why_channels,
    "sampler": _why_sampler,
}


def _technique_moments(
    estimator: AbstractEstimator,
    sampler: Sampler,
    n: int,
    realizations: int,
    stream: Stream,
    workers: int = 1,
) -> Moments:
    """Moments (C, T + 1) of the parts of the estimate that techniques make, and of their sum."""

    def of_block(block: Block) -> Moments:
        points = estimator.draw(sampler, n, stream, *block)
        parts = [
            estimator.primary_values(t, u).mean(axis=1).reshape(block[1], -1)
            for t, u in enumerate(points)
        ]
        return Moments.of(np.stack([*parts, sum(parts[1:], parts[0])], axis=2))

    numbers = n * estimator.dims * sum(estimator.counts)
    found = map_in_order(of_block, realization_blocks(realizations, numbers), workers)
    total = next(found)
    for moments in found:
        total = total.merge(moments)
    return total
