"""Pair correlation: findings, and what would contradict them."""

import mcspectra as mcs
from mcspectra.reproduction import pair_correlation as pairs
from mcspectra.reproduction.claims import judge


def test_pairs_of_another_sampler_disagree():
    data = {name: pairs.count_pairs(name, 200, 3) for name in ("random", "jittered")}
    assert judge(pairs._as_closed("jittered", data["random"])).agrees is False
    assert judge(pairs._as_closed("random", data["jittered"])).agrees is False
    assert judge(pairs._hole(data["jittered"])).agrees is False


def test_the_power_of_another_sampler_disagrees(monkeypatch):
    right = mcs.closed_form_power

    def wrong(name, n, m):
        return right({"random": "jittered", "jittered": "random"}[name], n, m)

    monkeypatch.setattr(mcs, "closed_form_power", wrong)
    assert judge(pairs._transformed("random")).agrees is False
    assert judge(pairs._transformed("jittered")).agrees is False


def test_variances_of_different_samplers_disagree():
    counted, _ = pairs.routes("jittered | shift", 200, 1)
    _, measured = pairs.routes("poisson-disk", 200, 1)
    assert judge(pairs._counted_pairs("", counted, measured)).agrees is False
    assert judge(pairs._shifted(counted)).agrees is True
    assert judge(pairs._shifted(counted / 0.5)).agrees is False
