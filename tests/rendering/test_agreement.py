"""Images compared with Mitsuba's own `direct` integrator by a test of every pixel.

Both sides are means of independent batches, so that each pixel has a Welch t statistic. The mean of
the crop is one more hypothesis. Šidák's correction gives all a common level. The same test must
detect a technique that is wrong by 2 %.
"""

from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from mcspectra.core.checks import Array
from mcspectra.rendering import load_mitsuba, load_scene, wavefront
from mcspectra.rendering.image import render

pytestmark = pytest.mark.render

LEVEL = 1e-3  # probability that a correct image is rejected
BATCHES = 16
SPP = 256  # samples per pixel of each batch and side
# The two smallest lights are left out: BSDF sampling hits them so rarely that batches are not
# normal. The crop contains the largest light, and parts of the wall and the plates.
VEACH = "veach(width=24, height=16, lights=['light-2', 'light-3'])"
CROPS = {"veach": (12, 0, 12, 12), "layered": (2, 3, 12, 8)}
CHANGES = {
    'name="width" value="40"': 'name="width" value="16"',
    'name="height" value="30"': 'name="height" value="12"',
    "</film>": '<rfilter type="box"/></film>',
    # Less glossy, so that light sampling resolves 2 % with a million samples.
    'name="roughness" value="0.3"': 'name="roughness" value="0.8"',
}
STOCK = {"light": (1, 0), "bsdf": (0, 1), "mis": (1, 1)}


# Each technique alone is tested quickly in one scene, and MIS in both
QUICK = {("veach", "light"), ("layered", "bsdf"), ("veach", "mis"), ("layered", "mis")}


def pairs(*strategies):
    """Return parameters (scene, strategy), the slow ones marked."""
    return [
        pytest.param(name, each, marks=[] if (name, each) in QUICK else [pytest.mark.slow])
        for name in CROPS
        for each in strategies
    ]


@pytest.fixture(scope="module")
def scenes(scene_files, tmp_path_factory):
    """Veach's scene, and a principled floor under a textured light and a sky."""
    text = Path(scene_files["textured"]).read_text(encoding="utf-8")
    for old, new in CHANGES.items():
        assert old in text
        text = text.replace(old, new)
    file = tmp_path_factory.mktemp("agreement") / "layered.xml"
    file.write_text(text, encoding="utf-8")
    return {"veach": VEACH, "layered": str(file)}


@pytest.fixture(scope="module")
def stock(scenes):
    """Cached batches of the stock integrator: (scene, strategy) to (BATCHES, h, w, 3)."""
    kept: dict[tuple[str, str], Array] = {}

    def batches(name, strategy):
        key = (name, strategy)
        if key not in kept:
            kept[key] = _stock_batches(load_scene(scenes[name]), *STOCK[strategy])
        x, y, w, h = CROPS[name]
        return kept[key][:, y : y + h, x : x + w]

    return batches


def _stock_batches(scene, emitter_samples, bsdf_samples):
    mitsuba = load_mitsuba()
    counts = {"emitter_samples": emitter_samples, "bsdf_samples": bsdf_samples}
    direct = mitsuba.load_dict({"type": "direct", **counts})
    images = [
        np.array(mitsuba.render(scene, integrator=direct, spp=SPP, seed=mitsuba.UInt32(seed)))
        for seed in range(BATCHES)
    ]
    return np.stack(images).astype(np.float64)


def smallest_p_value(stock, ours):
    """Šidák-corrected p-value of the worst pixel and channel, or of the mean of the crop."""
    mean, variance = stock.mean(axis=0), stock.var(axis=0, ddof=1) / BATCHES
    other, rest = ours["image"].values, ours["image_se"].values ** 2
    # Rounding of float32 sums of SPP values, for values that are otherwise constant
    floor = (SPP * 2.0**-24 * mean) ** 2 / 12
    total = variance + rest
    freedom = (BATCHES - 1) * total**2 / np.maximum(variance**2 + rest**2, 1e-300)
    freedom = np.maximum(freedom, BATCHES - 1.0)
    with np.errstate(invalid="ignore"):
        t = (mean - other) / np.sqrt(total + floor)
    t = np.where(mean == other, 0.0, t)
    p = 2 * stats.t.sf(np.abs(t), freedom)
    z = (mean - other).sum(axis=(0, 1)) / np.sqrt(_variance_of_sum(stock) + rest.sum(axis=(0, 1)))
    whole = 2 * stats.t.sf(np.abs(z), BATCHES - 1)
    worst, hypotheses = min(p.min(), whole.min()), p.size + whole.size
    return float(-np.expm1(hypotheses * np.log1p(-min(worst, 1.0 - 1e-16))))


def _variance_of_sum(stock):
    return np.asarray(stock.sum(axis=(1, 2)).var(axis=0, ddof=1) / BATCHES)


def ours(scene, name, strategy):
    options = {"spp": SPP, "realizations": BATCHES, "crop": CROPS[name]}
    return render(scene, strategy, "sobol | owen", **options, rng=5)


@pytest.mark.parametrize(("name", "strategy"), pairs(*STOCK))
def test_every_pixel_agrees_with_the_stock_integrator(scenes, stock, name, strategy):
    p = smallest_p_value(stock(name, strategy), ours(scenes[name], name, strategy))
    assert p > LEVEL


@pytest.mark.parametrize(("name", "strategy"), pairs("light", "bsdf"))
def test_an_error_of_two_percent_is_detected(
    monkeypatch,
    scenes,
    stock,
    name,
    strategy,
):
    right = getattr(wavefront, f"sample_{strategy}")

    def too_bright(*given):
        value, own, other = right(*given)
        return 1.02 * value, own, other

    monkeypatch.setattr(wavefront, f"sample_{strategy}", too_bright)
    p = smallest_p_value(stock(name, strategy), ours(scenes[name], name, strategy))
    assert p < LEVEL


@pytest.mark.parametrize("name", list(CROPS))
def test_weights_that_do_not_sum_to_one_are_detected(monkeypatch, scenes, stock, name):
    right = wavefront.heuristic_weight
    monkeypatch.setattr(wavefront, "heuristic_weight", lambda *given: 1.02 * right(*given))
    assert smallest_p_value(stock(name, "mis"), ours(scenes[name], name, "mis")) < LEVEL
