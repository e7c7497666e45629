"""Objectives of a design: classes of integrands, with random members or a known covariance.

With C_f = E[f_m conj(f_l)], the expected variance over a class is tr(C_f C_S).
This is the sum of the variances of functions g_t with Σ_t g_t(x) g_t(y) = E[f(x) f(y)].
For M random integrands, the functions g_t are these integrands divided by √M.
For a covariance of coefficients, the g_t are its eigenvectors times the roots of its eigenvalues.
For a spectrum, the g_t are the waves √(2 P(m)) cos(2π m·x) and √(2 P(m)) sin(2π m·x).
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeAlias, final

import numpy as np

from mcspectra.core.checks import Array, as_integer
from mcspectra.core.errors import (
    DomainError,
    McspectraError,
    ParameterError,
    SpecError,
    close_match_hint,
)
from mcspectra.core.spec import Call, parse
from mcspectra.estimators.quadrature import grid
from mcspectra.integrands import Integrand
from mcspectra.integrands.registry import INTEGRANDS, as_integrand
from mcspectra.samplers.stratified import Random

__all__ = ["Objective", "Values", "as_objective"]

Values: TypeAlias = Callable[[Array], Array]
"""Functions whose variances sum to the expected variance; they map points (N, d) to (M, N)."""


@final
@dataclass(frozen=True)
class ObjectiveSettings:
    """Settings of classes of integrands."""

    # Maximum number of dims of a class. The searches use tables of 2^18 values.
    # In 8-D, 2^18 values are only about 2^2 values along each axis.
    most_dims: int = 8
    # Maximum number of waves of a spectrum. It is also the limit for eigenvectors of a covariance.
    # The waves or eigenvectors with the largest power are kept.
    # Each wave gives two functions, a cosine and a sine.
    most_waves: int = 1024
    # Number of random integrands, and number of points, with which a class is tested.
    # The test refuses classes whose integrands are all constant.
    # Integrands that are constant in all but 1/8192 of the volume are refused by mistake.
    probe_members: int = 16
    probe_points: int = 2**13
    # Default and largest half width h of a spectrum or a covariance given as a function.
    # A spectrum has (2h + 1)^d values, which are 2.1e6 values for h = 64 in 3-D.
    usual_half_width: int = 8
    most_half_width: int = 64


_SETTINGS = ObjectiveSettings()
_FAMILIES = {
    "gaussians": "gaussian(center=uniform(0, 1), width=uniform(0.1, 0.4))",
    "disks": "disk(center=uniform(0, 1), radius=uniform(0.1, 0.4))",
}
_HALF_SPACES = "half-spaces"
_RANDOM = re.compile(r"=\s*(uniform|normal)\s*\(([^()]*)\)")


@final
@dataclass(frozen=True)
class Objective:
    """A class of integrands in `dims` dims.

    Attributes
    ----------
    text
        Name of the class in messages.
    draw
        Function of M and a random generator that returns M random integrands of the class.
        For a list of integrands, the function returns all integrands of the list.
    whole
        The functions of the whole class if all of them are known; otherwise None.
    """

    text: str
    dims: int
    draw: Callable[[int, np.random.Generator], Values]
    whole: Values | None = None

    def functions(self, members: int, rng: np.random.Generator) -> Values:
        """Return all integrands of the class if they are known, or `members` random ones."""
        return self.whole or self.draw(members, rng)


def as_objective(given: object, dims: int | None = None) -> Objective:
    """Read an objective; see `design`.

    By default, the integrands determine the number of dims; it is 2 if they allow any number.

    Raises
    ------
    ParameterError
        If the objective cannot be read, is empty, or contains only constant integrands.
        If the number of dims is not between 1 and 8.
    DomainError
        If values are not finite.
    """
    if dims is not None:
        dims = as_integer("dims", dims, least=1, most=_SETTINGS.most_dims)
    objective = _read(given, dims)
    as_integer("dims", objective.dims, least=1, most=_SETTINGS.most_dims)
    probe = objective.draw(_SETTINGS.probe_members, np.random.default_rng(0))
    values = probe(Random(dims=objective.dims).draw(_SETTINGS.probe_points, rng=0)[0])
    if not np.ptp(values, axis=1).any():
        raise ParameterError(
            f"All members of {objective.text} looked at are constant, so that every sampler has a "
            "variance of 0; give integrands that vary."
        )
    return objective


def _read(given: Any, dims: int | None) -> Objective:
    if isinstance(given, str):
        return _of_text(given.strip(), dims)
    if isinstance(given, Integrand):
        return _of_one(as_integrand(given, dims))
    if isinstance(given, Mapping):
        return _of_waves(given, dims)
    if isinstance(given, Sequence):
        # All parts of the list count equally. If all are integrands, they are the whole class
        if not given:
            raise ParameterError("The objective is an empty list; give one integrand at least.")
        # Integrands given as text get the number of dims from the other integrands
        dims = dims or _read(min(given, key=lambda part: isinstance(part, str)), None).dims
        parts = [_read(part, dims) for part in given]
        if len(parts) == 1:
            return parts[0]

        def joined(values: Sequence[Values]) -> Values:
            return lambda x: len(parts) ** -0.5 * np.concatenate([value(x) for value in values])

        def draw(count: int, rng: np.random.Generator) -> Values:
            return joined([part.draw(-(-count // len(parts)), rng) for part in parts])

        known = [part.whole for part in parts if part.whole]
        whole = joined(known) if len(known) == len(parts) else None
        return Objective(f"{len(parts)} of {parts[0].text} …", dims, draw, whole)
    if isinstance(given, np.ndarray):
        squared = given.ndim > (dims or given.ndim)
        return _of_waves({"covariance" if squared else "spectrum": given}, dims)
    if callable(given):
        name = getattr(given, "__name__", "the class")

        def one(rng: np.random.Generator) -> Integrand:
            try:
                found = given(rng)
            except McspectraError:
                raise
            # The argument of a user's function is a random generator.
            # A function that expects points raises an AttributeError, a TypeError or a ValueError
            except (AttributeError, TypeError, ValueError) as error:
                raise ParameterError(
                    f"{name} raised {type(error).__name__} of a generator: {error}; give a "
                    "function of a generator that makes an integrand, or for one function "
                    "Integrand.from_function."
                ) from error
            return as_integrand(found, dims)

        return _drawn(name, dims or one(np.random.default_rng(0)).dims, one)
    raise ParameterError(
        f"The objective is {given!r:.80}; give a spec with uniform(a, b) or normal(mean, sd) for "
        "parameters, a function of a generator that makes an integrand, a list of these, or "
        "{'spectrum': ...} or {'covariance': ...}."
    )


def _of_one(f: Integrand) -> Objective:
    values = partial(_members, [f])
    return Objective(f.spec, f.dims, lambda count, rng: values, values)  # noqa: ARG005


def _of_text(text: str, dims: int | None) -> Objective:
    """Read a family of integrands, or a spec with parameters uniform(a, b) or normal(mean, sd)."""
    if text == _HALF_SPACES:
        d = dims or 2

        def half_space(rng: np.random.Generator) -> Integrand:
            """Draw a half-space: its border has a random direction and contains a random point."""
            normal = rng.standard_normal(d)
            normal /= np.sqrt(normal @ normal)
            arguments = {"normal": normal.tolist(), "offset": float(normal @ rng.random(d))}
            found: Integrand = INTEGRANDS.build(Call("half-space", arguments), d)
            return found

        return _drawn(text, d, half_space)
    call = parse(_RANDOM.sub(r"=['\1', \2]", _FAMILIES.get(text, text)))
    laws = {
        name: value
        for name, value in call.arguments.items()
        if isinstance(value, list) and value and value[0] in ("uniform", "normal")
    }
    for name, (law, *ends) in laws.items():
        if (
            len(ends) != 2
            or not all(isinstance(x, int | float) for x in ends)
            or ends[1] <= (ends[0] if law == "uniform" else 0)
        ):
            need = "low < high" if law == "uniform" else "a mean and a positive deviation"
            raise SpecError(f"{name} is {law}({', '.join(map(repr, ends))}); give {need}.")
    if not laws:
        if call.name not in INTEGRANDS:
            hint, _ = close_match_hint(
                call.name, [*_FAMILIES, _HALF_SPACES, *INTEGRANDS], "mcspectra list integrands"
            )
            raise SpecError(f"There is no integrand or class {call.name!r}.{hint}")
        return _of_one(as_integrand(text, dims))

    def make(size: Mapping[str, int], rng: np.random.Generator) -> Integrand:
        drawn = {
            name: getattr(rng, law)(*ends, size=size[name]).tolist()
            for name, (law, *ends) in laws.items()
        }
        drawn = {name: x if len(x) > 1 else x[0] for name, x in drawn.items()}
        found: Integrand = INTEGRANDS.build(Call(call.name, call.arguments | drawn), dims)
        return found

    dims = dims or make(dict.fromkeys(laws, 1), np.random.default_rng(0)).dims

    # If the integrand accepts a list for a parameter, draw a value for each axis
    error: Exception | None = None
    for sizes in itertools.product((dims, 1), repeat=len(laws)):
        size = dict(zip(laws, sizes, strict=True))
        try:
            make(size, np.random.default_rng(0))
            return _drawn(text, dims, partial(make, size))
        except ParameterError as refused:
            error = refused
    raise error or ParameterError(f"{text} cannot be made.")


def _drawn(text: str, dims: int, one: Callable[[np.random.Generator], Integrand]) -> Objective:
    return Objective(
        text, dims, lambda count, rng: partial(_members, [one(rng) for _ in range(count)])
    )


def _members(integrands: Sequence[Integrand], x: Array) -> Array:
    """Return the values of all channels, divided by the root of the number of integrands.

    Because of the division, the sum of the squared values is a mean over the integrands.
    """
    rows = []
    for f in integrands:
        values = f(x)
        if not np.isfinite(values).all():
            raise DomainError(f"{f.spec} is not finite at some points; designs need finite values.")
        rows.append(values[None] if values.ndim == 1 else values.T)
    return np.asarray(np.concatenate(rows) * len(integrands) ** -0.5)


def _of_waves(given: Mapping[str, Any], dims: int | None) -> Objective:
    """Read {'spectrum': P} or {'covariance': C}; P and C are arrays or callables of frequencies."""
    kinds = [kind for kind in ("spectrum", "covariance") if kind in given]
    if len(kinds) != 1 or set(given) - {*kinds, "half_width"}:
        raise ParameterError(
            f"The objective has the keys {', '.join(map(repr, given)) or 'none'}; give 'spectrum' "
            "or 'covariance', and 'half_width' where it is a function."
        )
    (kind,) = kinds
    source = given[kind]
    if callable(source):
        dims = dims or 2
        half = given.get("half_width", _SETTINGS.usual_half_width)
        half = as_integer("half_width", half, least=1, most=_SETTINGS.most_half_width)
    else:
        source = np.asarray(source)
        dims = dims or (source.ndim if kind == "spectrum" else 2)
        half = (round(len(source) ** (1.0 if kind == "spectrum" else 1.0 / dims)) - 1) // 2
    m = grid(np.arange(-half, half + 1), dims)
    if not callable(source):
        needed = (2 * half + 1,) * dims if kind == "spectrum" else (len(m), len(m))
        if source.shape != needed or half < 1:
            raise ParameterError(
                f"The {kind} has shape {source.shape}; give (2h + 1, …) for each of {dims} dims"
                + ("." if kind == "spectrum" else ", in C order, as rows and as columns.")
            )

    # Compute the strongest waves of a spectrum, or the eigenvectors of a covariance
    if kind == "spectrum":
        power = np.asarray(source(m) if callable(source) else source).reshape(-1)
        _check_numbers(kind, power, (len(m),))
        if np.iscomplexobj(power) or (power < 0).any():
            raise ParameterError(
                "The spectrum has values that are negative or complex; power is not."
            )
        power = 0.5 * (power + power[::-1])
        later = np.arange(len(m) // 2 + 1, len(m))  # Of the frequencies m and −m, keep one
        kept = later[np.argsort(-power[later], kind="stable")[: _SETTINGS.most_waves]]
        kept = kept[power[kept] > 0]
        vectors, m = np.diag(np.sqrt(2.0 * power[kept])), m[kept]
    else:
        most = 2 * _SETTINGS.most_waves
        if len(m) > most:
            raise ParameterError(
                f"A covariance of {len(m)} frequencies is too large; give at most {most}: "
                "lower half_width, or give a spectrum."
            )
        matrix = np.asarray(source(m[:, None], m[None]) if callable(source) else source)
        _check_numbers(kind, matrix, (len(m), len(m)))
        sizes, found = np.linalg.eigh(0.5 * (matrix + matrix.conj().T))
        if sizes.min() < -1e-8 * np.abs(sizes).max() or not np.allclose(matrix, matrix.conj().T):
            raise ParameterError(
                "The covariance is not Hermitian and positive semidefinite; give E[f_m conj(f_l)]."
            )
        kept = np.argsort(-sizes)[: _SETTINGS.most_waves]
        kept = kept[sizes[kept] > 1e-12 * sizes.max()]
        vectors = (found[:, kept] * np.sqrt(sizes[kept])).T

    def whole(x: Array) -> Array:
        waves = vectors @ np.exp(2j * np.pi * (m @ x.T))
        return np.concatenate([waves.real, waves.imag])

    def draw(count: int, rng: np.random.Generator) -> Values:
        mixed = rng.standard_normal((count, 2 * len(vectors))) / np.sqrt(count)
        return lambda x: mixed @ whole(x)

    return Objective(f"a {kind} of half width {half}", dims, draw, whole)


def _check_numbers(kind: str, values: Array, shape: tuple[int, ...]) -> None:
    if values.shape != shape or values.dtype.kind not in "fiuc" or not np.isfinite(values).all():
        raise ParameterError(
            f"The {kind} gives {values.dtype} of shape {values.shape}, or values that are not "
            f"finite; give finite numbers of shape {shape}."
        )
