"""Rates predicted from two exponents: how power starts at low frequencies, how an integrand ends.

Let the power of a homogeneous set be ⟨P(m)⟩ = (1/n) min(1, (ρ/n^(1/d))^b), ρ = |m|, and the mean of |f_m|² over
the directions fall like ρ^-γ. Then, with N = n^(1/d) the frequency up to which the set helps,

    Var = Σ |f_m|² ⟨P(m)⟩ ~ (1/n) [N^-b ∫_1^N ρ^(b + d − 1 − γ) dρ + ∫_N^∞ ρ^(d − 1 − γ) dρ].

Either the lowest frequencies dominate, n^(−1 − b/d), or those about N, n^(−1 − (γ − d)/d), whichever is
the slower [Pilleboue2015]_. A jump across a hypersurface has γ = d + 1, a kink d + 3. On the torus,
where shifted sets live, a smooth function whose values at 0 and 1 differ has a jump too.
"""

from __future__ import annotations

import math

import numpy as np

from mcspectra.core.checks import MAX_DIMS, Array, as_choice, as_integer
from mcspectra.core.errors import ParameterError
from mcspectra.integrands import Integrand
from mcspectra.integrands.registry import as_integrand

__all__ = ["DECAYS", "integrand_decay", "predicted_rate"]

DECAYS = {"jump": 1.0, "kink": 3.0, "smooth": math.inf}
"""γ − d by what is not smooth: values, first derivatives across a hypersurface, or nothing."""

_SHELLS = 3  # octaves that the decay is fitted to
_LEAST_WIDTH = 1 << _SHELLS
_NOISE = 1e-26  # |f_m|² relative to the largest that double precision knows nothing of


def predicted_rate(b: float, decay: float | str, dims: int) -> float:
    """Predict the exponent of the variance in n.

    Parameters
    ----------
    b
        Low-frequency exponent of the power: 0 for random and Poisson disk sets, 2 for jittered
        ones, more for those that are optimised to be smooth; infinite for step noise.
    decay
        γ: |f_m|², averaged over directions, falls like |m|^-γ; more than `dims` for a finite variance.
        Or ``"jump"``, ``"kink"``, ``"smooth"`` for what the integrand has on the torus: `DECAYS`.
    dims
        Number of dims d.

    Returns
    -------
    float
        −1 − min(b, γ − d)/d. Where b = γ − d there is a factor log n besides.

    Raises
    ------
    ParameterError
        A value is out of range: b ≤ −d, γ ≤ d.

    Notes
    -----
    For homogeneous sets, whose spectrum is all there is: shifted at random. Jittered sets that are not
    shifted have no jump at the border of a smooth function: ``"smooth"`` then.

    Examples
    --------
    >>> import mcspectra as mcs
    >>> mcs.predicted_rate(2, "smooth", 2), mcs.predicted_rate(2, "jump", 2)
    (-2.0, -1.5)
    """
    d = as_integer("dims", dims, least=1, most=MAX_DIMS)
    if isinstance(decay, str):
        excess = DECAYS[as_choice("decay", decay, tuple(DECAYS))]
    else:
        excess = _exponent("decay", decay, above=d) - d
    best = min(_exponent("b", b, above=-d), excess)
    return -1.0 - best / d


def integrand_decay(integrand: Integrand | str, *, half_width: int = 64) -> float:
    """Measure γ, the decay of |f_m|² averaged over directions, at the end of the spectrum.

    Parameters
    ----------
    integrand
        f, or its spec string.
    half_width
        K: the slope is fitted over the last three octaves up to |m| = K; at least 8.

    Returns
    -------
    float
        γ, infinite where the coefficients there are rounding noise. Of several channels the least.

    Examples
    --------
    >>> import mcspectra as mcs
    >>> round(mcs.integrand_decay("disk", half_width=64), 1)
    3.0
    """
    f = as_integrand(integrand)
    width = as_integer("half_width", half_width, least=_LEAST_WIDTH)
    power = np.abs(f.fourier_grid(width)) ** 2
    power = power.reshape(*power.shape[: f.dims], -1)
    axes = np.meshgrid(*[np.arange(-width, width + 1) ** 2] * f.dims, indexing="ij")
    length = np.sqrt(sum(axes, np.zeros(())))
    return min(_slope(power[..., c], length, width) for c in range(power.shape[-1]))


def _slope(power: Array, length: Array, width: int) -> float:
    """Minus the slope of log mean power against log |m| over octaves (K/2, K], (K/4, K/2], …"""
    edges = width * 0.5 ** np.arange(_SHELLS, -1, -1)
    place = np.searchsorted(edges, length, side="left")
    shells = [power[place == k].mean() for k in range(1, _SHELLS + 1)]
    if min(shells) <= _NOISE * power.max():
        return math.inf
    return -float(np.polyfit(np.arange(_SHELLS), np.log2(shells), 1)[0])


def _exponent(name: str, value: object, *, above: float) -> float:
    """A real number above a limit, possibly infinite."""
    number = isinstance(value, int | float | np.integer | np.floating)
    if not number or isinstance(value, bool) or not float(value) > above:  # type: ignore[arg-type]
        raise ParameterError(f"{name} is {value!r}; give a number greater than {above:g}.")
    return float(value)  # type: ignore[arg-type]
