"""The slowest technique: findings, and what would contradict them."""

import numpy as np
import pytest
import xarray as xr

from mcspectra.reproduction import mis_slowest as slowest
from mcspectra.reproduction.claims import judge

pytestmark = pytest.mark.render


def curves(rates, variances):
    rate, variance = np.array(rates), np.array(variances)[:, None]
    return xr.Dataset(
        {
            "rate": ("estimator", rate),
            "rate_ci": (("estimator", "bound"), np.stack([rate - 0.05, rate + 0.05], axis=1)),
            "variance": (("estimator", "n"), variance),
            "variance_ci": (
                ("estimator", "n", "bound"),
                np.stack([variance / 1.2, variance * 1.2], axis=2),
            ),
        },
        {"n": [64]},
    )


def test_a_sum_with_the_rate_of_the_faster_one_disagrees():
    right = curves([-2.0, -1.5, -1.5, -2.0, -1.5], [1, 9, 5, 1, 9])
    wrong = curves([-2.0, -1.5, -2.0, -2.0, -1.5], [1, 9, 5, 9, 1])
    for check in (slowest._follows, slowest._what_is_left):
        assert judge(check("wall", right)).agrees is True
        assert judge(check("wall", wrong)).agrees is False


def test_toy_rates_of_the_other_technique_disagree():
    toy = slowest.toy_curves(300, 1)
    swapped = dict(zip(toy, [toy[name] for name in reversed(slowest.TECHNIQUES)], strict=False))
    for technique in (0, 1):
        assert judge(slowest._toy_rate(toy, technique)).agrees is True
        assert judge(slowest._toy_rate(swapped, technique)).agrees is False
    assert judge(slowest._bottleneck("undecided")).agrees is False


def test_another_step_disagrees(monkeypatch):
    right = slowest.exact
    monkeypatch.setattr(slowest, "exact", lambda technique: 1.001 * right(technique))
    assert judge(slowest._toy_formula()).agrees is False
