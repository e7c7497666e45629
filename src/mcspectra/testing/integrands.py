"""The contract of integrands: shapes, and closed forms that agree with the values."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.integrands import Integrand, integral_accuracy
from mcspectra.integrands.registry import as_integrand
from mcspectra.testing.contract import (
    called,
    check_breaks,
    demand,
    mean_and_error,
    point_sets,
    values_at,
)

__all__ = ["check_integrand"]

_SPREADS = 7.0  # Student's t with 31 degrees: 7e-8 a number
_ROUNDING = 1e-12
_REMAINDER = 3.5  # of a quadrature whose last difference halves like √½: borders do better
_QUADRATURE_DIMS = 3
_MISSED = 20.0  # points expected in a region that none hits: probability e^-20
_FREQUENCIES = ((1,), (-3,), (0, 2), (1, -1), (4, 7), (2, 1, 0), (0, -1, 3))


def check_integrand(integrand: Integrand | str, *, dims: int | None = None) -> None:
    """Check an integrand against the contract of all integrands.

    Parameters
    ----------
    integrand
        The integrand, or its spec string.
    dims
        Number of dims of a spec string without ``dims``.

    Raises
    ------
    BrokenContract
        Values, integral or coefficients raise, have another shape or type, or are not finite;
        values depend on the other points, or the given points are changed; breaks are not ascending
        numbers within (0, 1); or a closed form (integral, coefficients, means over boxes) is not
        that of the values (false alarm: about 1e-6).

    Notes
    -----
    Closed forms are compared with means over 32 shifted sets of 4096 points; those further off
    than seven standard errors are compared with a quadrature as well, in up to three dims.
    A closed form that is wrong by less than those errors passes. A region of less than 1e-4 of the
    domain, where alone f is not 0, has to be named by `Integrand.landmarks`.

    Examples
    --------
    >>> check_integrand("gaussian(width=0.3)", dims=2)
    """
    f = as_integrand(integrand, dims)
    x = point_sets(f.dims)
    few = x[:3, :5]
    values = values_at(f.spec, "its values", f, few, (*few.shape[:-1], *_channels(f)))
    demand(bool(np.isfinite(values).all()), f.spec, "gives values that are not finite")
    check_breaks(f.spec, f.breaks, f.dims)
    _check_integral(f, x)
    _check_coefficients(f, x)
    _check_boxes(f, x)


def _channels(f: Integrand) -> tuple[int, ...]:
    return (f.channels,) if f.channels else ()


def _check_integral(f: Integrand, x: Array) -> None:
    found = np.asarray(called(f.spec, "its integral", lambda: f.integral))
    demand(found.shape == _channels(f), f.spec, f"has an integral of shape {found.shape}")
    demand(bool(np.isfinite(found).all()), f.spec, "has an integral that is not finite")
    if f._integral() is not None:
        _compare(f, "an integral", found[..., None], x, np.ones(x.shape[:-1])[..., None])


def _check_coefficients(f: Integrand, x: Array) -> None:
    """Shapes, f_0 = ∫f, f_−m = conj f_m, and closed forms against points."""
    who = f.spec
    m = np.array([row + (0,) * (f.dims - len(row)) for row in _FREQUENCIES if len(row) <= f.dims])
    if called(who, "its coefficients", f._fourier, np.zeros((1, f.dims))) is None:
        return  # the library's own, whatever the integrand
    found = called(who, "its coefficients", f.fourier, m.reshape(1, -1, f.dims))
    wanted = (1, len(m), *_channels(f))
    demand(found.shape == wanted, who, f"has coefficients of shape {found.shape}, not {wanted}")
    demand(found.dtype == np.complex128, who, f"has coefficients {found.dtype}, not complex128")
    dc = called(who, "its coefficients", f.fourier, np.zeros((1, f.dims)))[0]
    size = 1.0 + float(np.abs(np.asarray(f.integral)).max())
    demand(
        bool(np.abs(dc - f.integral).max() <= 1e-9 * size),
        who,
        "has a coefficient f_0 that is not its integral",
    )
    mirrored = called(who, "its coefficients", f.fourier, -m)
    demand(
        bool(np.abs(mirrored - found[0].conj()).max() <= 1e-9 * size),
        who,
        "has coefficients with f_-m ≠ conj(f_m)",
    )
    angle = 2.0 * np.pi * (x @ m.T)
    values = found[0].T if f.channels else found[0]
    _compare(f, "coefficients", values.real, x, np.cos(angle))
    _compare(f, "coefficients", values.imag, x, -np.sin(angle))


def _check_boxes(f: Integrand, x: Array) -> None:
    """Means of f and f² over boxes with irregular borders, and over the whole."""
    low = np.stack([np.zeros(f.dims), np.full(f.dims, 0.17), np.linspace(0.03, 0.4, f.dims)])
    high = np.stack([np.ones(f.dims), np.full(f.dims, 0.61), np.full(f.dims, 0.97)])
    found = called(f.spec, "box_moments", f.box_moments, low, high)
    if found is None:
        return
    wanted = (len(low), *_channels(f))
    for part in found:
        demand(np.shape(part) == wanted, f.spec, f"has box moments of shape {np.shape(part)}")
    for k, (a, b) in enumerate(zip(low, high, strict=True)):
        for power, part in enumerate(found, 1):
            box = _Seen(f, tuple(a), tuple(b), power)
            _compare(
                box, "box moments", np.asarray(part)[k][..., None], x, np.ones((*x.shape[:-1], 1))
            )


@final
@dataclass(frozen=True, eq=False)
class _Seen(Integrand):
    """Values of another integrand, or of its square, over a box: without any closed form."""

    name: ClassVar[str] = "seen"
    inner: Integrand
    low: tuple[float, ...]
    high: tuple[float, ...]
    power: int = 1

    @property
    def dims(self) -> int:  # type: ignore[override]
        """Dims of the other."""
        return self.inner.dims

    @property
    def channels(self) -> int:  # type: ignore[override]
        """Channels of the other."""
        return self.inner.channels

    @property
    def spec(self) -> str:
        """Spec of the other."""
        return self.inner.spec

    def landmarks(self) -> Array:
        """Landmarks of the other that lie in the box."""
        low, high = np.array(self.low), np.array(self.high)
        places = (self.inner.landmarks() - low) / (high - low)
        return np.asarray(places[((places >= 0.0) & (places <= 1.0)).all(axis=1)])

    @property
    def breaks(self) -> tuple[tuple[float, ...], ...]:
        """Breaks of the other that lie in the box."""
        ends = zip(self.inner.breaks, self.low, self.high, strict=True)
        return tuple(tuple((c - a) / (b - a) for c in axis if a < c < b) for axis, a, b in ends)

    def _evaluate(self, x: Array) -> Array:
        low, high = np.array(self.low), np.array(self.high)
        values: Array = self.inner(np.minimum(low + (high - low) * x, 1.0)) ** self.power
        return values


def _compare(f: Integrand, what: str, claimed: Array, x: Array, factors: Array) -> None:
    """Compare claims (..., k) with means over points of values times factors (sets, points, k)."""
    values = called(f.spec, "its values", f, x)
    products = values[..., None] * (factors[..., None, :] if f.channels else factors)
    mean, error = mean_and_error(products)
    rounding = _ROUNDING * (1.0 + float(np.abs(values).max()))
    allowed = _SPREADS * error + rounding
    if not values.any():
        allowed = allowed + _missed(f) * _MISSED / values.shape[0] / values.shape[1]
    off = ~(np.abs(claimed - mean) <= allowed)
    if not off.any():
        return
    ones = factors.shape[-1] == 1
    agree = ones and f.dims <= _QUADRATURE_DIMS and _quadrature_agrees(f, claimed[..., 0])
    claim, seen, spread = (float(a[off][0]) for a in (claimed, mean, error))
    demand(
        agree,
        f.spec,
        f"has {what} in conflict with its values: {claim:.6g}, but points give {seen:.6g} "
        f"± {spread:.2g}",
    )


def _missed(f: Integrand) -> float:
    """Largest size of f at its landmarks, which all points of a check have missed."""
    places = f.landmarks()
    return float(np.abs(f(places)).max()) if len(places) else 0.0


def _quadrature_agrees(f: Integrand, claimed: Array) -> bool:
    """Whether a quadrature of the values finds the integral: points may miss a small region."""
    whole = (0.0,) * f.dims, (1.0,) * f.dims
    seen = f if isinstance(f, _Seen) else _Seen(f, *whole)
    error = _REMAINDER * integral_accuracy(seen)[1] + 1e-13
    return bool(np.abs(np.asarray(seen.integral) - claimed).max() <= error)
