"""Prime numbers, and powers of the bases in which digits are expanded."""

from __future__ import annotations

import math

__all__ = ["LARGEST_BASE", "is_prime", "power_from", "prime_from"]

LARGEST_BASE = 2**13
"""Largest base of digits. It is above the 1,000th prime.

For every base b up to this number, the smallest power b^m ≥ 2^32 is far below 2^53.
"""


def is_prime(n: int) -> bool:
    """Whether `n` is a prime, by trial division."""
    return n > 1 and all(n % k for k in range(2, math.isqrt(n) + 1))


def prime_from(n: int) -> int:
    """Return the smallest prime ≥ n."""
    n = max(n, 2)
    while not is_prime(n):
        n += 1
    return n


def power_from(n: int, base: int) -> int:
    """Return the smallest m with base^m ≥ n."""
    m = 0
    while base**m < n:
        m += 1
    return m
