"""The numba decorator of all kernels, with one choice of compiler flags.

`nogil` lets a thread pool run kernels in parallel; `cache` keeps compiled code between runs.
Kernels use neither `parallel=True` nor cached `guvectorize`.
In worker processes, `parallel=True` and cached `guvectorize` can fail by race conditions
(open numba issues 4807 and 10128).
If several processes need the same kernel, one compiles it, and the others wait for its code.
"""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Callable, Iterator
from typing import Any, TypeVar

import numba
from numba.core.compiler_lock import global_compiler_lock

__all__ = ["kernel"]

Function = TypeVar("Function", bound=Callable[..., Any])

_LONGEST_WAIT = 60.0  # seconds; the slowest kernel compiles in 15 s on a busy machine
_STEP = 0.02  # seconds between two attempts to get the lock


def kernel(function: Function) -> Function:
    """Compile a function with numba, without the GIL. ``MCSPECTRA_NUMBA_CACHE=0``: no cache."""
    cache = os.environ.get("MCSPECTRA_NUMBA_CACHE", "1") != "0"
    compiled: Any = numba.njit(nogil=True, cache=cache)(function)
    if cache:
        compile_now = compiled.compile

        def compile_once(signature: Any) -> Any:
            # Take numba's lock first, as nested kernels do, so that threads do not block each other
            with global_compiler_lock, _locked(f"{function.__module__}.{function.__name__}"):
                # This call loads the code if another process has stored it
                return compile_now(signature)

        compiled.compile = compile_once
    return compiled  # type: ignore[no-any-return]


@contextlib.contextmanager
def _locked(name: str) -> Iterator[None]:
    """Hold a lock that excludes other processes, if the platform has one; a lost lock is harmless.

    A process locks a kernel before it locks the kernels that this kernel calls.
    Calls of kernels never form a circle, so two processes cannot block each other forever.
    After a wait of 60 s, for example for a stopped process, a kernel is compiled without the lock.
    """
    try:
        import fcntl

        from mcspectra.core.cache import cache_folder

        # Other users could place links in a folder that they share with this user
        folder = cache_folder() / "kernels"
        folder.mkdir(parents=True, exist_ok=True)
        file = (folder / name).open("a")
    except (ImportError, OSError):
        yield
        return
    with file:
        end = time.monotonic() + _LONGEST_WAIT
        while True:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                if time.monotonic() > end:
                    break
                time.sleep(_STEP)
            except OSError:
                break
            else:
                break
        yield
