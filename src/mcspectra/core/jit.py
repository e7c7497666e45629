"""The numba decorator of all kernels, with one choice of compiler flags.

With `nogil`, a thread pool can run kernels in parallel. `cache` stores compiled code between runs.
Kernels use neither numba's parallel loops (`parallel=True`) nor its cached `guvectorize`.
Both have race conditions with several worker processes (numba issues 4807, 10128).
"""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any, TypeVar

import numba

__all__ = ["kernel"]

Function = TypeVar("Function", bound=Callable[..., Any])


def kernel(function: Function) -> Function:
    """Compile a function with numba, without the GIL. ``MCSPECTRA_NUMBA_CACHE=0``: no cache."""
    cache = os.environ.get("MCSPECTRA_NUMBA_CACHE", "1") != "0"
    compiled: Any = numba.njit(nogil=True, cache=cache)(function)
    return compiled  # type: ignore[no-any-return]
