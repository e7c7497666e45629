"""Memory that analyses need, checked before anything is allocated."""

from __future__ import annotations

import os

from mcspectra.core.errors import ConfigError, Function

__all__ = ["available_memory", "check_memory", "memory_of", "shown_bytes"]

_COPIES = 4  # of the points: as drawn, warped, with their values and weights
_GRIDS = 8  # complex arrays over the frequencies: transform, sums, squares, coefficients
_NUMBERS = 2**21  # of a block of realizations (core.parallel)
_BASE = 2**20


def memory_of(n: int, dims: int, techniques: int = 1, frequencies: int = 0) -> int:
    """Bytes that an analysis of n points takes at most, beyond those of the program itself.

    Parameters
    ----------
    n, dims, techniques
        Points of a technique, axes, and number of techniques in units of n.
    frequencies
        Size of the grid of frequencies.
    """
    block = max(_NUMBERS, n * dims * techniques)
    return _BASE + 8 * _COPIES * block + 16 * _GRIDS * frequencies


def available_memory() -> int:
    """Bytes of memory of this machine; 2^62 where the system does not say."""
    try:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):
        return 2**62


def check_memory(needed: int, what: str | Function) -> None:
    """Refuse what needs more bytes than this machine has.

    Parameters
    ----------
    needed
        Bytes.
    what
        Beginning of the sentence, a function or a text such as ``"Estimator 'a', convergence with n = 10"``.

    Raises
    ------
    ConfigError
        With the estimate.
    """
    most = available_memory()
    if needed > most:
        raise ConfigError(
            what,
            f" would take about {shown_bytes(needed)} of memory, and this machine has "
            f"{shown_bytes(most)}; ask for fewer points, dims or frequencies.",
        )


def shown_bytes(size: float) -> str:
    """A size as people read it, such as ``1.5 GB``."""
    units = ("B", "kB", "MB", "GB", "TB", "PB")
    power = sum(size >= 1000**k for k in range(1, len(units)))
    return f"{size / 1000**power:.3g} {units[power]}"
