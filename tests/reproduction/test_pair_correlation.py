"""Pair correlation: findings, and wrong inputs that must disagree."""

from __future__ import annotations

from typing import Any

import pytest
from tests.reproduction.conftest import Disagreeing

import mcspectra as mcs
from mcspectra.reproduction import pair_correlation as pairs


def test_pairs_and_powers_of_another_sampler_disagree(
    disagreeing: Disagreeing, monkeypatch: pytest.MonkeyPatch
) -> None:
    power, count_pairs, by_pairs = mcs.closed_form_power, pairs.count_pairs, pairs.by_pairs
    others = {"random": "jittered", "jittered": "random", "poisson-disk": "jittered"}

    def twice(*_: Any) -> Any:
        counted, measured = by_pairs("jittered | shift", 200, 1)
        return counted / 0.5, measured

    monkeypatch.setattr(mcs, "closed_form_power", lambda name, *rest: power(others[name], *rest))
    assert disagreeing(
        pairs, count_pairs=lambda name, *_: count_pairs(others[name], 200, 3), by_pairs=twice
    ) == [0, 1, 2, 3, 4, 8, 9, 10]
