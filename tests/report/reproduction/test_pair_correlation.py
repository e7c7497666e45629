"""Pair correlation: findings, and what would contradict them."""

from __future__ import annotations

from typing import Any

import pytest

from mcspectra.report.reproduction import pair_correlation as pairs
from mcspectra.report.reproduction.base import Exhibit
from mcspectra.spectra import closed_forms


@pytest.fixture(scope="module")
def made() -> Exhibit:
    return pairs.exhibit(quick=True, seed=1)


def test_all_findings_agree(made: Exhibit) -> None:
    assert made.name == "pair-correlation"
    assert [f.statement for f in made.findings if f.agrees is not True] == []
    assert all(len(p.alt) > 40 for p in made.pictures)


def test_pairs_of_another_sampler_disagree() -> None:
    data = {name: pairs._pairs(name, 200, 3) for name in ("random", "jittered")}
    assert pairs._as_closed("jittered", data["random"]).agrees is False
    assert pairs._as_closed("random", data["jittered"]).agrees is False
    assert pairs._hole(data["jittered"]).agrees is False


def test_the_power_of_another_sampler_disagrees(monkeypatch: pytest.MonkeyPatch) -> None:
    right = closed_forms.closed_form_power

    def wrong(name: str, n: int, m: Any) -> Any:
        return right({"random": "jittered", "jittered": "random"}[name], n, m)

    monkeypatch.setattr(closed_forms, "closed_form_power", wrong)
    assert pairs._transform("random").agrees is False
    assert pairs._transform("jittered").agrees is False


def test_variances_of_different_samplers_disagree() -> None:
    found, _ = pairs._routes("jittered | shift", 200, 1)
    _, curve = pairs._routes("poisson-disk", 200, 1)
    assert pairs._counted_pairs("", found, curve).agrees is False
    assert pairs._shifted(found).agrees is True
    assert pairs._shifted(2.0 * found).agrees is False
