"""Causes of noise of an estimator with its sampler, and reasons why a change lowers the noise.

The causes are the same as in a profile. There are two further reasons why a change may help:
unbounded weights 1/p, and a primary-space integrand g that is partly odd about the center.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass

from mcspectra.core.errors import McspectraError
from mcspectra.core.streams import Stream
from mcspectra.core.tally import counting
from mcspectra.estimators import AbstractEstimator
from mcspectra.estimators.mirrored import SymmetrizedIntegrand
from mcspectra.estimators.support import probe_points
from mcspectra.explain.causes import Cause, Evidence, causes_of, technique_name
from mcspectra.samplers import Sampler

__all__ = ["Diagnosis", "diagnose", "jumps_inside"]


@dataclass(frozen=True)
class DiagnosisSettings:
    """Number of evaluations in a search for causes, and limits of the odd part of the variance."""

    # Number of evaluations of g in the search for causes.
    # With fewer evaluations, `python -m benchmarks battery` does not detect all causes.
    evaluations: int = 8192
    # Two limits of the odd part of g, as fractions of the variance of g.
    # If the odd part is over 90 % of the variance, it is named as the reason for a gain.
    # If the odd part is at least 10 % of the variance, it is named as one of several reasons.
    mostly: float = 0.9
    partly: float = 0.1
    # Maximum number of dims in which the odd part is measured.
    # All 2^d reflections of each point are evaluated.
    odd_dims: int = 4
    # Number of points at which the odd part is measured.
    # With 4096 points, the odd part has an error of about 1 % of the variance.
    # An error of 1 % is small enough to compare the odd part with the limits `mostly` and `partly`.
    odd_points: int = 2**12


_SETTINGS = DiagnosisSettings()


@dataclass(frozen=True)
class Diagnosis:
    """Causes of noise, and other reasons why a change may help."""

    causes: list[Cause]  # the most important cause first; empty if causes are not known
    unseen: str = ""  # why causes could not be found
    unbounded: bool = False  # whether ∫1/p diverges
    slow: str = ""  # name of the technique with most of the variance, if any
    # Fraction of the variance of g that the mean over all reflections removes, or None
    odd: float | None = None

    @property
    def main(self) -> str:
        """Sentences about the most important cause, or why causes could not be found."""
        return self.causes[0].sentence if self.causes else self.unseen

    @property
    def text(self) -> str:
        """Sentences about the causes, joined to one text."""
        found = [cause.sentence for cause in self.causes] or [self.unseen]
        if self.unbounded:
            found.insert(
                0,
                "1/p is unbounded: ∫1/p diverges, and rare samples get large weights unless f "
                "vanishes with p.",
            )
        return " ".join(found)

    def removes(
        self, kind: str, name: str, *, biased: bool, unbounded: bool, jumps: bool | None
    ) -> str:
        """Describe the cause of noise that a change of the set-up removes, or return "" if unknown.

        Parameters
        ----------
        kind, name, biased
            Attributes of the `mcspectra.improve.answers.Candidate`.
        unbounded, jumps
            Used if the change is another warp. `unbounded` is true if ∫1/p diverges.
            `jumps` is true if g jumps inside the cube, and None if jumps were not tested.
        """
        # Each kind of change to the set-up removes certain causes of noise
        inside = _jumps(self.causes)
        wrapped = any(cause.name == "border-jump" for cause in self.causes)
        odd = f"{100 * (self.odd or 0.0):.0f} % of the variance of g"
        uniform = name.endswith("uniform")
        match kind:
            case "mirrored" if uniform and (self.odd or 0.0) >= _SETTINGS.mostly:
                return f"g is odd about the center ({odd}): the images of a sample cancel it."
            case "unshifted" if wrapped:
                return "Without the shift no stratum contains the jump between opposite sides."
            case "mirrored" if wrapped:
                return (
                    "After reflection, g is continuous across the sides: wrap-around adds no jump."
                )
            case "mirrored" if uniform and (self.odd or 0.0) >= _SETTINGS.partly:
                return (
                    f"The images of a sample cancel the part that is odd about the center, {odd}."
                )
            case "aligned" if inside:
                return "Borders of strata lie where g jumps, so fewer strata contain a jump."
            case "aligned" if wrapped:
                return "Strata without a shift do not wrap around the jump between opposite sides."
            case "smoothed" if inside and biased:
                return "The jump inside becomes a ramp; the mean squared error includes its bias."
            case "smoothed" if inside:
                return "The jump inside becomes a ramp; means over boxes keep the integral."
            case "warp" if self.unbounded and not unbounded:
                return "Its 1/p is bounded."
            case "warp" if inside and jumps is False:
                return "Its g does not jump inside."
            case "fitted":
                return "Its density is large where g is, as a pilot showed."
            case "regression":
                return (
                    "A polynomial that explains part of g has a known integral and is subtracted."
                )
            case "order":
                return (
                    "The first coordinates, which samplers resolve best, are those that g depends "
                    "on most."
                )
            case "preintegrated":
                return "It integrates across the jump of g, on both of its sides."
            case "cubic":
                return (
                    "Polynomials in each cube explain part of g, as far as g is smooth, and are "
                    "subtracted."
                )
            case "periodized":
                return (
                    "Its g is constant at the border and periodic, so lattices have a steep rate."
                )
            case "heuristic" if self.slow:
                return f"It changes the contribution of {self.slow}, most of the variance."
            case "techniques" if self.slow and name != f"only {self.slow}":
                return f"It leaves out {self.slow}, which causes most of the variance."
            case "channels" if name.endswith("combined"):
                return "No channel depends only on samples of a density of another shape."
            case "channels":
                return "Each channel is divided by a density of its own shape."
        return ""


def diagnose(
    estimator: AbstractEstimator, sampler: Sampler, stream: Stream, most: int | None = None
) -> Diagnosis:
    """Find the causes of noise, within `most` evaluations of a user's function."""
    with counting("The diagnosis", most):
        causes, unseen = _looked_for(estimator, sampler, stream, most)
        # Compute the fraction of the variance of g that cancels in a mean over reflections.
        # All 2^d reflections about the center are used, at fixed points.
        # `odd` remains None if g is constant, cannot be evaluated or has too many dims
        odd, whole, even = None, 0.0, 0.0
        with suppress(McspectraError):
            few = estimator.dims <= _SETTINGS.odd_dims
            for t, count in enumerate(estimator.counts if few else ()):
                g = estimator.primary_integrand(t)
                u = probe_points(estimator.dims, _SETTINGS.odd_points)
                whole += float(g(u).var(axis=0).sum()) / count
                even += float(SymmetrizedIntegrand(g)(u).var(axis=0).sum()) / count
            odd = max(1.0 - even / whole, 0.0) if whole > 0 else None
    slow = next((cause for cause in causes if cause.name == "slow-technique"), None)
    return Diagnosis(
        causes,
        unseen,
        unbounded=estimator.infinite_weights,
        slow="" if slow is None else technique_name(estimator, int(slow.evidence["technique"])),
        odd=odd,
    )


def jumps_inside(estimator: AbstractEstimator, sampler: Sampler) -> bool | None:
    """Return whether g jumps inside the cube, or None if g could not be evaluated."""
    causes, unseen = _looked_for(estimator, sampler, Stream.from_rng(0), None)
    return None if unseen else _jumps(causes)


def _jumps(causes: list[Cause]) -> bool:
    return any(cause.name in ("interior-jump", "axis-parallel-jump") for cause in causes)


def _looked_for(
    estimator: AbstractEstimator, sampler: Sampler, stream: Stream, most: int | None
) -> tuple[list[Cause], str]:
    """Return the causes, or the reason why they could not be found."""
    budget = _SETTINGS.evaluations if most is None else min(most, _SETTINGS.evaluations)
    try:
        estimator.check_independent()
        return causes_of(Evidence.of(estimator, sampler, budget, stream)), ""
    except McspectraError as error:
        return [], f"The causes of noise could not be determined: {error}"
