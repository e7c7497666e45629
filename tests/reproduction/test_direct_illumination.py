"""Light and BSDF sampling of two pixels: findings, and wrong inputs that must disagree."""

import numpy as np
import pytest
import xarray as xr

from mcspectra.reproduction import direct_illumination as direct
from mcspectra.reproduction.claims import VERDICT_WIDENING, judge, pixel_rate
from mcspectra.reproduction.gallery import make_exhibit

pytestmark = pytest.mark.render


def test_all_findings_agree(sound):
    """One of eight curves is smooth, and each rate excludes the other rate."""
    made = make_exhibit("direct-illumination", quick=True, seed=1)[0]
    sound(made)
    rates = [f.expected.split()[0] for f in made.findings[:8]]
    assert rates == ["−2.0", *["−1.5"] * 7]
    for f in made.findings[:8]:
        assert f.interval is not None
        # The interval of a finding is already widened for all verdicts
        ends = [f.measured + (end - f.measured) / VERDICT_WIDENING for end in f.interval]
        curve = xr.Dataset({"rate": f.measured, "rate_ci": ("bound", ends)})
        right = -2.0 if f.expected.startswith("−2") else -1.5
        assert judge(pixel_rate("", curve, right)).agrees is True
        assert judge(pixel_rate("", curve, -3.5 - right)).agrees is False


def test_integrands_have_edges_except_light_sampling_at_p():
    u = (np.arange(64) + 0.5) / 64
    x = np.stack(np.meshgrid(u, u), axis=-1)
    steps = {}
    for case, g in direct.integrands().items():
        values = np.asarray(g(x))
        steps[case] = max(np.abs(np.diff(values, axis=k)).max() for k in (0, 1)) / values.max()
    smooth = steps.pop(("P", "light"))
    assert smooth < 0.1 < min(steps.values())


def test_different_radiances_disagree():
    def curve(mean):
        return xr.Dataset({"mean": ("n", [mean]), "mean_se": ("n", [0.01])})

    curves = {
        ((p, s), k): curve(1.0) for p in "PQ" for s in ("light", "bsdf") for k in direct.SAMPLERS
    }
    assert judge(direct._same_integral(curves)).agrees is True
    curves[("Q", "bsdf"), "jittered"] = curve(1.1)
    assert judge(direct._same_integral(curves)).agrees is False
