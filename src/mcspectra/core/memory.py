"""Estimates of the memory of an analysis, and checks before memory is allocated."""

from __future__ import annotations

import os

from mcspectra.core.errors import ConfigError, Function

__all__ = ["available_memory", "check_memory", "memory_of", "shown_bytes"]

# Number of copies of the points in memory: drawn points, warped points, values and weights
_COPIES = 4
# Number of arrays with a complex number for each frequency.
# The complex arrays hold transforms, sums, squares and coefficients
_GRIDS = 8
_NUMBERS = 2**21  # float64 numbers in a block of realizations (see core.parallel)
_BASE = 2**20


def memory_of(n: int, dims: int, techniques: int = 1, frequencies: int = 0) -> int:
    """Return the maximum number of bytes that an analysis of n points allocates.

    The memory of the program itself is not counted.

    Parameters
    ----------
    n, dims, techniques
        Points per technique, number of dims, and points of all techniques divided by n.
    frequencies
        Size of the frequency grid.
    """
    block = max(_NUMBERS, n * dims * techniques)
    return _BASE + 8 * _COPIES * block + 16 * _GRIDS * frequencies


def available_memory() -> int:
    """Return the bytes of memory of this machine, or 2^62 if the system does not report them."""
    try:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):
        return 2**62


def check_memory(needed: int, what: str | Function) -> None:
    """Raise an error if an analysis needs more bytes than this machine has.

    Parameters
    ----------
    needed
        Bytes needed.
    what
        The consumer of the memory: a function, or a text such as ``"convergence with n = 10"``.

    Raises
    ------
    ConfigError
        If `needed` exceeds the memory. The message contains the estimate.
    """
    most = available_memory()
    if needed > most:
        raise ConfigError(
            what,
            f" would take about {shown_bytes(needed)} of memory, and this machine has "
            f"{shown_bytes(most)}; ask for fewer points, dims or frequencies.",
        )


def shown_bytes(size: float) -> str:
    """Return a readable size, such as ``1.5 GB``."""
    units = ("B", "kB", "MB", "GB", "TB", "PB")
    power = sum(size >= 1000**k for k in range(1, len(units)))
    return f"{size / 1000**power:.3g} {units[power]}"
