"""Hypothesis strategies: random samplers, densities, integrands, counts and point sets.

Samplers are drawn from all registered names, including those of other packages.
Costly samplers and samplers that need parameters are excluded.
Densities and integrands have random parameters.
This module requires Hypothesis: ``pip install mcspectra[testing]``.
"""

from __future__ import annotations

import contextlib
import functools
import warnings
from typing import TYPE_CHECKING, Any

import numpy as np

from mcspectra.core.checks import as_choice, as_integer
from mcspectra.core.errors import McspectraError, MissingDependency, ParameterError
from mcspectra.densities import Density, density
from mcspectra.integrands import Integrand, integrand
from mcspectra.samplers import RANDOMIZATIONS, SAMPLERS, Sampler, as_sampler, sampler

try:
    from hypothesis import strategies as st
    from hypothesis.extra import numpy as hnp
except ImportError:
    raise MissingDependency(
        "mcspectra.testing.strategies needs hypothesis, which is not installed; run "
        "pip install mcspectra[testing]."
    ) from None

if TYPE_CHECKING:
    from hypothesis.strategies import SearchStrategy

__all__ = ["counts", "densities", "integrands", "point_sets", "samplers", "spec_strings"]

COMPONENT_KINDS = ("sampler", "density", "integrand")
MAX_DIMS = 16
_MOST_STEPS = 2
# Samplers that load other packages or require a file
_FOREIGN = (
    "command",
    "mitsuba",
    "points",
    "python",
    "qmcpy",
    "scipy",
)
_POINTWISE = ("shift", "digital-shift", "owen", "mirror")


def spec_strings(kind: str = "sampler", *, dims: int = 2) -> SearchStrategy[str]:
    """Strategy for spec strings of samplers, densities or integrands, in `dims` dims.

    Parameters
    ----------
    kind
        ``"sampler"`` (with randomizations), ``"density"`` or ``"integrand"``.
    dims
        Number of dims, 1 to 16.

    Raises
    ------
    ParameterError
        If the kind is unknown, or `dims` is out of range.
    """
    make = {"sampler": _sampler_specs, "density": _density_specs, "integrand": _integrand_specs}
    name = as_choice("kind", kind, COMPONENT_KINDS)
    return make[name](as_integer("dims", dims, least=1, most=MAX_DIMS))


def samplers(*, dims: int = 2) -> SearchStrategy[Sampler]:
    """Strategy for samplers in `dims` dims. Many are randomized; slow samplers are excluded."""
    return spec_strings("sampler", dims=dims).map(lambda spec: sampler(spec, dims))


def densities(*, dims: int = 1) -> SearchStrategy[Density]:
    """Strategy for densities in `dims` dims with random parameters."""
    return spec_strings("density", dims=dims).map(lambda spec: density(spec, dims))


def integrands(*, dims: int = 2) -> SearchStrategy[Integrand]:
    """Strategy for integrands in `dims` dims with random parameters, with and without jumps."""
    return spec_strings("integrand", dims=dims).map(lambda spec: integrand(spec, dims))


def counts(given: Sampler | str, *, most: int = 256) -> SearchStrategy[int]:
    """Strategy for numbers of points, at most `most`, that a sampler can draw without a warning.

    Raises
    ------
    ParameterError
        If the sampler cannot make a set of at most `most` points.
    """
    source = as_sampler(given)
    largest = as_integer("most", most, least=1, most=2**20)
    # If there are very many possible counts, try only some of them
    near = {source.nearest_count(k) for k in range(1, largest + 1, max(1, largest // 4096))}
    possible = []
    for n in sorted(n for n in near if n <= largest):
        with warnings.catch_warnings(record=True) as heard:
            warnings.simplefilter("always")
            source.check_count(n)
        possible += [] if heard else [n]
    if not possible:
        raise ParameterError(
            f"{source.spec} cannot make a set of at most {largest} points; give most="
            f"{source.nearest_count(1)}."
        )
    return st.sampled_from(possible)


def point_sets(*, dims: int = 2, most: int = 64, stacked: bool = False) -> SearchStrategy[Any]:
    """Strategy for float64 point sets in [0,1)^dims: (n, dims), or (R, n, dims) if `stacked`.

    Zeros, values close to 1 and repeated coordinates are more frequent than in random points.
    """
    d = as_integer("dims", dims, least=1, most=MAX_DIMS)
    largest = as_integer("most", most, least=1, most=2**16)
    coordinate = st.floats(0.0, 1.0, exclude_max=True, allow_subnormal=False)
    sizes = st.tuples(st.integers(1, 4), st.integers(1, largest))
    shapes = sizes.map(lambda size: (*size, d) if stacked else (size[1], d))
    return shapes.flatmap(lambda shape: hnp.arrays(np.float64, shape, elements=coordinate))


@functools.cache
def _names(dims: int) -> tuple[str, ...]:
    """Return the names of cheap samplers that need no parameters and support `dims` dims."""
    found = []
    for name in (n for n in SAMPLERS if n not in _FOREIGN):
        with contextlib.suppress(McspectraError):
            if not SAMPLERS.load(name).costly:
                sampler(name, dims)  # raises an error if parameters are missing or `dims` is wrong
                found.append(name)
    return tuple(found)


@st.composite
def _sampler_specs(draw: Any, dims: int) -> str:
    """Draw a sampler and up to two randomizations. Randomizations that do not fit are skipped."""
    made = sampler(draw(st.sampled_from(_names(dims))), dims)
    steps = st.lists(st.sampled_from(_POINTWISE), max_size=_MOST_STEPS, unique=True)
    for step in draw(steps):
        try:
            made = made.then(RANDOMIZATIONS.load(step)())
        except McspectraError:
            continue
    return made.spec


def _number(low: float, high: float) -> SearchStrategy[float]:
    """Strategy for numbers with few digits, so that specs are short and easy to read."""
    return st.integers(0, 64).map(lambda k: low + (high - low) * k / 64)


def _calls(name: str, **parameters: SearchStrategy[Any]) -> SearchStrategy[str]:
    """Strategy for specs ``name(key=value, …)`` with random values."""

    def spec(values: dict[str, Any]) -> str:
        return f"{name}({', '.join(f'{key}={value!r}' for key, value in values.items())})"

    return st.fixed_dictionaries(parameters).map(spec)


def _each(number: SearchStrategy[Any], dims: int) -> SearchStrategy[list[Any]]:
    return st.lists(number, min_size=dims, max_size=dims)


def _density_specs(dims: int) -> SearchStrategy[str]:
    specs = [
        st.just("uniform"),
        _calls("linear", slope=_each(_number(-2.0, 2.0), dims)),
        _calls("power", exponent=_each(_number(-0.5, 4.0), dims)),
        _calls("exponential", rate=_each(_number(-16.0, 16.0), dims)),
        _calls("tent", peak=_each(_number(0.0, 1.0), dims)),
        _calls(
            "truncated-normal",
            mean=_each(_number(-0.5, 1.5), dims),
            sigma=_each(_number(0.125, 2.125), dims),
        ),
    ]
    if dims == 1:
        specs.append(_calls("piecewise-constant", values=_each(st.integers(1, 9), 5)))
    return st.one_of(specs)


def _integrand_specs(dims: int) -> SearchStrategy[str]:
    specs = [
        _calls("linear", gradient=_each(_number(-2.0, 2.0), dims), offset=_number(-1.0, 1.0)),
        _calls("gaussian", center=_each(_number(0.0, 1.0), dims), width=_number(0.125, 2.125)),
        _calls("cosine", frequency=_each(st.integers(-4, 4), dims), phase=_number(0.0, 6.0)),
        _calls("step", at=_number(0.125, 0.875), axis=st.integers(0, dims - 1)),
    ]
    if dims <= 3:
        center = _each(_number(0.25, 0.75), dims)
        specs.append(_calls("disk", center=center, radius=_number(0.125, 0.5)))
    return st.one_of(specs)
