"""An estimator with its sampler, and the affordable numbers of points."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from mcspectra.core.errors import CountError
from mcspectra.estimators import AbstractEstimator
from mcspectra.samplers import Sampler

__all__ = ["Setup", "affordable_count"]


@dataclass(frozen=True)
class CountSettings:
    """Limits in the search for an affordable number of points."""

    # Number of candidate counts, for samplers that allow a count near every number.
    # Successive candidate counts differ by a factor of about 1 − 1/256.
    # With 64 or 1,024 candidate counts, the search finds the same number of points.
    tries: int = 256


_SETTINGS = CountSettings()


@dataclass(frozen=True)
class Setup:
    """An estimator with its sampler."""

    estimator: AbstractEstimator
    sampler: Sampler
    # Function that makes the estimator for n points, if the estimator depends on n
    at_count: Callable[[int], AbstractEstimator] | None = None

    def at(self, n: int) -> AbstractEstimator:
        """Return the estimator for n points."""
        return self.estimator if self.at_count is None else self.at_count(n)

    @property
    def cost(self) -> int:
        """Number of evaluations of the integrand for each of the n points."""
        return self.estimator.cost

    @property
    def overhead(self) -> int:
        """Number of evaluations before the first point, for example of a pilot."""
        return self.estimator.pilot_evaluations

    @property
    def is_black_box(self) -> bool:
        """Whether evaluations of the integrand count as expensive."""
        return self.estimator.is_black_box

    @property
    def unbiased(self) -> bool:
        """Whether the drawn points are uniform, so that estimates have no bias."""
        return self.estimator.randomized(self.sampler).unbiased

    def too_dear(self, budget: int) -> str:
        """Return the reason why a budget does not allow two counts."""
        if self.overhead >= budget:
            return f"Its pilot alone takes {self.overhead} evaluations; the budget is {budget}."
        if self.cost > sum(self.estimator.counts):
            points = self.cost // sum(self.estimator.counts)
            return f"Each of its samples takes {points} evaluations; too few fit into {budget}."
        return f"{self.sampler.spec} has no two counts within {budget} evaluations."


def affordable_count(setup: Setup, budget: int) -> int | None:
    """Return the largest n that can be drawn within `budget` evaluations, or None.

    Counts of nets away from powers of the base are poor; the sampler warns for these counts.
    The search skips counts for which the sampler warns.
    """
    source = setup.estimator.randomized(setup.sampler)
    n: int | None = min(max(budget - setup.overhead, 0) // setup.cost, source.max_count)
    for _ in range(_SETTINGS.tries):
        n = source._counts_near(n)[0] if n else None
        if not n:
            return None
        poor = any(source._count_warning(n * c) for c in setup.estimator.counts)
        if not poor:
            try:
                setup.estimator.check_sampler(setup.sampler, n)
            except CountError:
                pass
            else:
                return n
        # If the sampler warns about n points, reduce n to the next smaller power of its base.
        # If the sampler allows every count near n, reduce n by large steps
        base = max(source.digit_bases, default=2)
        power = base ** int(math.log(n, base) + 1e-9)
        if poor and power < n:
            n = power
            continue
        dense = len(setup.estimator.counts) == 1 and n >= _SETTINGS.tries
        n -= max(1, n // _SETTINGS.tries) if dense else 1
    return None
