"""A mixture by deterministic split: each part draws its share of the points."""

from __future__ import annotations

import math
from fractions import Fraction

from mcspectra.core.checks import Array, as_integer
from mcspectra.core.errors import ParameterError
from mcspectra.densities import Defensive, Density, Mixture, as_density
from mcspectra.estimators.mis import MultipleImportance
from mcspectra.integrands import Integrand, as_integrand

__all__ = ["split_mixture"]

_EXACT = 1e-9  # shares such as 0.1 + 0.2 are taken as the fractions they stand for


def split_mixture(
    integrand: Integrand | str, mixture: Density | str, *, most: int = 1000
) -> MultipleImportance:
    """Estimate with n w_t points of each part of a mixture, in place of points that choose.

    Parameters
    ----------
    integrand
        f, or its spec string.
    mixture
        `Mixture` or `Defensive`, or its spec string. Its selection does not matter.
    most
        Largest total count, the common denominator of the shares.

    Returns
    -------
    MultipleImportance
        The parts with counts in proportion to their shares and the balance heuristic, so that every
        point weighs 1/p of the mixture. With counts c_t the points are n Σ c_t in all. For random
        points its variance is at most that of the mixture (Owen, Zhou 2000, "Safe and effective
        importance sampling", §3.2: a stratified mixture).

    Raises
    ------
    ParameterError
        Not a mixture, or the shares have no common denominator up to `most`.

    Examples
    --------
    >>> e = split_mixture("gaussian(dims=1)", "mixture(parts=['uniform', 'tent'], weights=[1, 3])")
    >>> e.counts, [p.spec for p in e.densities]
    ((1, 3), ['uniform', 'tent'])
    """
    f = as_integrand(integrand, mixture.dims if isinstance(mixture, Density) else None)
    given = as_density(mixture, f.dims)
    found = given.mixture if isinstance(given, Defensive) else given
    if not isinstance(found, Mixture):
        raise ParameterError(
            f"{mixture!r:.80} is not a mixture; give mixture(parts=[…]) or defensive(density=…)."
        )
    counts = _counts(found.shares, as_integer("most", most, least=1))
    return MultipleImportance(f, found.parts, counts=counts)


def _counts(shares: Array, most: int) -> list[int]:
    """Return the smallest whole numbers in proportion to the shares."""
    fractions = [Fraction(share).limit_denominator(most) for share in shares.tolist()]
    total = math.lcm(*(fraction.denominator for fraction in fractions))
    far = max(abs(float(f) - share) for f, share in zip(fractions, shares.tolist(), strict=True))
    if far > _EXACT or total > most or sum(fractions) != 1:
        shown = ", ".join(f"{share:.6g}" for share in shares)
        raise ParameterError(
            f"The shares {shown} have no common denominator up to {most}; give weights that are "
            "whole numbers with a small sum, or raise most."
        )
    return [int(fraction * total) for fraction in fractions]
