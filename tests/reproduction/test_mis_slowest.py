"""The slowest technique: findings, and wrong inputs that must disagree."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from tests.reproduction.conftest import Disagreeing

from mcspectra.reproduction import mis_slowest as slowest
from mcspectra.reproduction.claims import judge

pytestmark = pytest.mark.render


def curves(rates: list[float], variances: list[float]) -> xr.Dataset:
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


def test_a_sum_with_the_rate_of_the_faster_one_disagrees() -> None:
    right = curves([-2.0, -1.5, -1.5, -2.0, -1.5], [1, 9, 5, 1, 9])
    wrong = curves([-2.0, -1.5, -2.0, -2.0, -1.5], [1, 9, 5, 9, 1])
    for check in (slowest._follows, slowest._what_is_left):
        assert judge(check("wall", right)).agrees is True
        assert judge(check("wall", wrong)).agrees is False


def test_mis_in_a_pixel_is_as_slow_as_bsdf_sampling() -> None:
    found = slowest._pixel("wall", (6, 8, 11, 16), 60, 1)
    for check in (slowest._follows, slowest._what_is_left):
        assert judge(check("wall", found)).agrees is True


def test_the_other_technique_of_the_toy_disagrees(disagreeing: Disagreeing) -> None:
    toy, right = slowest.toy_curves(300, 1), slowest.exact
    names = [*slowest.TECHNIQUES]
    swapped = dict(zip(names, [toy[name] for name in reversed(names)], strict=True))
    swapped["sum"] = toy["sum"].assign_attrs(bottleneck="undecided")
    pixel = curves([-2.0, -1.5, -1.5, -2.0, -1.5], [1, 9, 5, 1, 9])
    assert disagreeing(
        slowest,
        toy_curves=lambda *_: swapped,
        exact=lambda technique: 1.001 * right(technique),
        _pixel=lambda *_: pixel.assign(mean=xr.ones_like(pixel["variance"])),
    ) == [0, 1, 3, 4]
