"""A density of three callables, checked when it is made."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, final

import numpy as np

from mcspectra.core.checks import Array, as_integer
from mcspectra.core.errors import DensityError
from mcspectra.densities.base import Density

__all__ = ["FunctionDensity", "call_function", "function_density", "function_spec"]

_MAX_DIMS = 1024
_PROBE = 5  # points of the first try; odd and small, so that no shape fits by accident


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class FunctionDensity(Density):
    """Given by functions pdf, sample and (optionally) invert.

    Make it by `Density.from_functions`, which checks it. The functions are called with read-only
    float64 arrays of shape (..., d), with any number of axes in front.
    """

    name: ClassVar[str] = "function"
    dims: int
    pdf_function: Callable[[Any], Any]
    sample_function: Callable[[Any], Any]
    invert_function: Callable[[Any], Any] | None = None

    @property
    def spec(self) -> str:
        """``function``, with the name of the pdf; not a spec that can be read back."""
        return function_spec(self.pdf_function)

    @property
    def has_inverse(self) -> bool:
        """Whether invert was given."""
        return self.invert_function is not None

    def _try(self) -> None:
        """Call all functions on few points, with one and with two axes in front."""
        for shape in [(_PROBE, self.dims), (_PROBE, 2, self.dims)]:
            u = np.linspace(0.2, 0.8, int(np.prod(shape))).reshape(shape)
            self._pdf(u)
            x = self._sample(u)
            if self.has_inverse:
                self._invert(np.clip(x, 0.0, np.nextafter(1.0, 0.0)))

    def _pdf(self, x: Array) -> Array:
        return call_function("pdf", self.spec, self.pdf_function, x, x.shape[:-1])

    def _sample(self, u: Array) -> Array:
        return call_function("sample", self.spec, self.sample_function, u, u.shape)

    def _invert(self, x: Array) -> Array:
        if self.invert_function is None:
            raise DensityError(
                f"The density {self.spec} was given without an inverse; give invert=."
            )
        return call_function("invert", self.spec, self.invert_function, x, x.shape)


def function_density(
    *,
    pdf: Callable[[Any], Any],
    sample: Callable[[Any], Any],
    invert: Callable[[Any], Any] | None = None,
    dims: int = 1,
) -> FunctionDensity:
    """Make and check a density of vectorised callables.

    Parameters
    ----------
    pdf
        Density: points (..., d) to (...); integral 1. It may be 0 on a set of measure zero.
    sample
        The warp T: primary points (..., d) in [0,1) to points (..., d) in [0,1).
    invert
        Its inverse, if known.
    dims
        Number of dims d.

    Raises
    ------
    DensityError
        Not callable, failing on a try, of the wrong shape, or not belonging together (see
        `mcspectra.densities.check_density`).

    Examples
    --------
    >>> import numpy as np
    >>> p = function_density(
    ...     pdf=lambda x: 2 * x[..., 0], sample=np.sqrt, invert=np.square
    ... )
    >>> p.sample([[0.25]])
    array([[0.5]])
    """
    for name, function in (("pdf", pdf), ("sample", sample), ("invert", invert)):
        if not callable(function) and not (name == "invert" and function is None):
            raise DensityError(f"{name} is {function!r}; give a function of points (..., d).")
    made = FunctionDensity(
        dims=as_integer("dims", dims, least=1, most=_MAX_DIMS),
        pdf_function=pdf,
        sample_function=sample,
        invert_function=invert,
    )
    made._try()
    made.check()
    return made


def function_spec(pdf: Callable[[Any], Any]) -> str:
    """``function``, with the name of the pdf where it has one."""
    called = getattr(pdf, "__name__", "")
    return f"function({called})" if called.isidentifier() else "function"


def call_function(
    name: str, spec: str, function: Callable[[Any], Any], points: Array, shape: tuple[int, ...]
) -> Array:
    """Call `function` of the density `spec` and check that it gave numbers of `shape`.

    Raises
    ------
    DensityError
        It failed, or gave something else.
    """
    shown = points.view()
    shown.setflags(write=False)
    try:
        given = np.asarray(function(shown))
    except Exception as error:
        raise DensityError(
            f"The {name} of {spec} failed on points of shape {points.shape}: "
            f"{type(error).__name__}: {error}"
        ) from error
    if given.dtype.kind not in "fiub":
        raise DensityError(f"The {name} of {spec} gave {given.dtype}, not real numbers.")
    if given.shape != shape:
        raise DensityError(
            f"The {name} of {spec} gave shape {given.shape} for points of shape "
            f"{points.shape}; it must give {shape}.{_shape_advice(name, given.shape, shape)}"
        )
    return np.asarray(given, np.float64)


def _shape_advice(name: str, given: tuple[int, ...], wanted: tuple[int, ...]) -> str:
    if name == "pdf" and given == (*wanted, 1):
        return " Write x[..., 0] in place of x."
    return ""
