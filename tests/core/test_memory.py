"""Memory of analyses: estimated from sizes, and checked before anything is allocated."""

import pytest

from mcspectra.core import memory
from mcspectra.core.errors import ConfigError


def test_memory_of_large_analyses(monkeypatch):
    points = 10**8
    assert memory.memory_of(points, 3, 2) == 2**20 + 8 * 4 * points * 6
    assert memory.memory_of(1, 1, 1, points) - memory.memory_of(1, 1) == 16 * 8 * points
    monkeypatch.setattr(memory.os, "sysconf", lambda name: 10)
    assert memory.available_memory() == 100
    memory.check_memory(100, "It")
    with pytest.raises(ConfigError, match=r"It would take about 101 B of memory.* 100 B;"):
        memory.check_memory(101, "It")


def test_sizes_in_words():
    words = [memory.shown_bytes(s) for s in (0, 999, 1000, 1.5e6, 2e9, 64e12, 3e15, 3e19)]
    assert words == ["0 B", "999 B", "1 kB", "1.5 MB", "2 GB", "64 TB", "3 PB", "3e+04 PB"]
