"""One numba decorator for every kernel, so that its flags are chosen once.

`nogil` lets a thread pool run kernels side by side; `cache` keeps compiled code between runs. No
`parallel=True` and no cached `guvectorize`: both have open races under worker processes
(numba issues 4807 and 10128).
"""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any, TypeVar

import numba

__all__ = ["kernel"]

Function = TypeVar("Function", bound=Callable[..., Any])


def kernel(function: Function) -> Function:
    """Compile `function` with numba: no GIL, cached unless ``MCSPECTRA_NUMBA_CACHE=0``."""
    cache = os.environ.get("MCSPECTRA_NUMBA_CACHE", "1") != "0"
    compiled: Any = numba.njit(nogil=True, cache=cache)(function)
    return compiled  # type: ignore[no-any-return]
