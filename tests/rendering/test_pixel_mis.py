"""Multiple importance sampling at a pixel by every heuristic: means, exact variances, analyses."""

import numpy as np
import pytest
from tests.rendering.samples import mean_and_error, uniforms

import mcspectra as mcs
from mcspectra.core.errors import ParameterError
from mcspectra.core.streams import Stream
from mcspectra.estimators import HEURISTICS
from mcspectra.improve.candidates import Budget, candidates_of
from mcspectra.measure.setup import Setup
from mcspectra.rendering import Pixel, load_mitsuba, named_pixels, pixel_mis, sky_pixels
from mcspectra.rendering.pixel import Draws
from mcspectra.samplers.registry import as_sampler

pytestmark = [pytest.mark.render, pytest.mark.usefixtures("coarse_pixels")]

WALL = {"scene": "veach", "x": 568, "y": 100, "light": "light-3"}
PLATE = {"scene": "veach", "x": 600, "y": 430, "light": "light-3"}
PLASTIC = {"scene": "sky", "x": 192, "y": 87}
COUNT = 2**15
SIGMAS = 4.5  # limit for some thirty compared means: one false alarm in 5000 runs


def total(mis, seed=1):
    """Mean and standard error of Σ_t g_t of independent random points."""
    parts = [
        mean_and_error(mis.primary_values(t, uniforms(COUNT, mis.dims, seed + t)))
        for t in range(len(mis.counts))
    ]
    return sum(m for m, _ in parts), np.sqrt(sum(e**2 for _, e in parts))


def random_variance(mis):
    """Variance of one random sample per unit of counts, Σ_t Var g_t / counts[t]."""
    values = [
        mis.primary_values(t, uniforms(2 * COUNT, mis.dims, 1 + t)) for t in range(len(mis.counts))
    ]
    return float(sum(v.var(ddof=1) / c for v, c in zip(values, mis.counts, strict=True)))


@pytest.fixture(scope="module")
def truth():
    """Mean and error by light sampling alone, without weights."""
    places = {"wall": WALL, "plate": PLATE}
    return {k: mean_and_error(Pixel(**p)(uniforms(2**18, seed=99))) for k, p in places.items()}


EVERY = [*HEURISTICS, "power(beta=3.5)", "cutoff(alpha=0.5)"]
UNEQUAL = ("balance", "optimal", "cutoff")


@pytest.mark.parametrize(
    ("heuristic", "counts"),
    [
        *((heuristic, (1, 1)) for heuristic in EVERY),
        *(
            pytest.param(each, (1, 5), marks=[] if each in UNEQUAL else [pytest.mark.slow])
            for each in EVERY
        ),
    ],
)
def test_every_heuristic_estimates_the_same(truth, heuristic, counts):
    for name, place in (("wall", WALL), ("plate", PLATE)):
        mean, error = total(pixel_mis(**place, heuristic=heuristic, counts=counts))
        wanted, wanted_error = truth[name]
        assert abs(mean - wanted) < SIGMAS * np.hypot(error, wanted_error)


@pytest.mark.parametrize("heuristic", ["balance", "power"])
def test_equal_counts_agree_with_the_kernels_of_pixel(heuristic):
    mis, u = pixel_mis(**PLATE, heuristic=heuristic), uniforms(4096)
    for technique, strategy in enumerate(("mis-light", "mis-bsdf")):
        single = Pixel(**PLATE, strategy=strategy, heuristic=heuristic)(u)
        values = mis.primary_values(technique, u)
        np.testing.assert_allclose(values, single, rtol=2e-5, atol=1e-6 * single.max())


@pytest.mark.parametrize("counts", [(1, 1), (3, 2)])
@pytest.mark.parametrize("heuristic", ["balance", "power(beta=3)", "maximum", "cutoff"])
def test_weights_sum_to_one_where_both_techniques_sample(heuristic, counts):
    # The weights of the drawing technique and of the other, at the same sample, sum to one
    mis = pixel_mis(**PLATE, heuristic=heuristic, counts=counts)
    drawn = mis.draws(0, uniforms(4096))
    shared = (drawn.pdfs > 0).all(axis=0)
    assert shared.mean() > 0.9
    f = drawn.values * drawn.pdfs[0]
    over = [
        mis._weigh(t, Draws(np.where(shared, f / drawn.pdfs[t].clip(1e-30), 0.0), drawn.pdfs))
        for t in range(2)
    ]
    sums = sum(g * p for g, p in zip(over, drawn.pdfs, strict=True))[shared]
    np.testing.assert_allclose(sums, f[shared], rtol=1e-12)


def test_counts_enter_the_weights():
    mis, u = pixel_mis(**PLATE, counts=(3, 2)), uniforms(4096)
    for technique, count in enumerate((3, 2)):
        drawn = mis.draws(technique, u)
        light, bsdf = drawn.pdfs
        wanted = drawn.values * drawn.pdfs[technique] * count / (3 * light + 2 * bsdf)
        np.testing.assert_allclose(mis.primary_values(technique, u), wanted, rtol=1e-12)


def test_optimal_weights_have_the_least_variance():
    # 4096 pilot samples give α to some percent: the minimum is flat, 3 % is allowed
    for place in (WALL, PLATE):
        found = {h: random_variance(pixel_mis(**place, heuristic=h)) for h in HEURISTICS}
        assert found["optimal"] == pytest.approx(min(found.values()), rel=0.03)
        assert found["variance-aware"] < found["balance"]


def test_weights_favor_light_samples_without_variance():
    # light-3 covers a small part of the wall's sky: almost all samples go to light sampling
    mis = pixel_mis(**WALL, heuristic="variance-aware")
    assert mis.shares[0] > 20 * mis.shares[1]


def test_pilots_are_reproducible_and_have_a_seed():
    made = [pixel_mis(**PLATE, heuristic=f"optimal(seed={s})").control for s in (0, 0, 1)]
    assert all(c is not None for c in made)
    np.testing.assert_array_equal(made[0], made[1])
    assert (made[0] != made[2]).all()
    np.testing.assert_array_equal(made[0], pixel_mis(**PLATE, heuristic="optimal").control)


@pytest.mark.parametrize("heuristic", ["balance", "optimal", "variance-aware"])
def test_channels_are_weighted_by_the_same_densities(heuristic):
    mis = pixel_mis(**PLATE, heuristic=heuristic, channel="rgb")
    mean, error = total(mis)
    for c in range(3):
        wanted, wanted_error = mean_and_error(Pixel(**PLATE, channel=c)(uniforms(2**18, seed=9)))
        assert abs(mean[c] - wanted) < SIGMAS * np.hypot(error[c], wanted_error)
    if heuristic == "optimal":
        assert mis.control is not None
        assert mis.control.shape == (2, 3)


def test_samples_below_the_surface_do_not_bias_optimal_weights():
    # A wide lobe at a grazing angle reaches below the surface; the control variate must cancel
    camera = {
        "type": "perspective",
        "fov": 5.0,
        "to_world": load_mitsuba().ScalarTransform4f().look_at([0, 0.3, 4], [0, 0, 0], [0, 1, 0]),
        "film": {"type": "hdrfilm", "width": 8, "height": 8},
    }
    lamp = {"type": "sphere", "center": [0.0, 1.0, -1.5], "radius": 0.7}
    scene = {
        "type": "scene",
        "sensor": camera,
        "floor": {"type": "disk", "bsdf": {"type": "roughconductor", "alpha": 0.6}},
        "lamp": {**lamp, "emitter": {"type": "area"}},
    }
    floor = load_mitsuba().ScalarTransform4f().rotate([1, 0, 0], -90)
    scene["floor"]["to_world"] = floor
    place = {"scene": scene, "x": 4, "y": 4}
    mean, error = total(pixel_mis(**place, heuristic="optimal"))
    wanted, wanted_error = mean_and_error(Pixel(**place)(uniforms(2**18, seed=99)))
    assert abs(mean - wanted) < SIGMAS * np.hypot(error, wanted_error)


def test_blocked_light_does_not_bias_optimal_weights():
    # Rays to a hidden part of the light, and rays to the occluder, are no samples of each other
    x, y = named_pixels("figure1")["Q"]
    mis = pixel_mis("figure1", x, y, heuristic="optimal")
    assert (mis.draws(0, uniforms(COUNT)).values == 0).mean() > 0.05
    mean, error = total(mis)
    light = Pixel(scene="figure1", x=x, y=y)
    wanted, wanted_error = mean_and_error(light(uniforms(2**18, seed=99)))
    assert abs(mean - wanted) < SIGMAS * np.hypot(error, wanted_error)


@pytest.fixture(scope="module")
def plastic():
    """Mean and error at the plastic ball by the techniques of the renderer."""
    return total(pixel_mis(**PLASTIC, channel="rgb", dims=3), seed=77)


SKY = [f"environment(interpolation='bilinear', channel={c})" for c in range(3)]


@pytest.mark.parametrize(
    ("techniques", "heuristic"),
    [
        pytest.param(["environment", "bsdf"], "optimal", marks=pytest.mark.slow),
        pytest.param([*SKY, "bsdf"], "balance", marks=pytest.mark.slow),
        (["environment(compensation=True)", "bsdf"], "optimal"),
        pytest.param(SKY, "balance", marks=pytest.mark.slow),
    ],
)
def test_densities_of_the_environment_are_techniques(plastic, techniques, heuristic):
    wanted, wanted_error = plastic
    mis = pixel_mis(**PLASTIC, techniques=techniques, heuristic=heuristic, channel="rgb", dims=3)
    mean, error = total(mis)
    assert (abs(mean - wanted) < SIGMAS * np.hypot(error, wanted_error)).all()


def test_analyses_work():
    mis = pixel_mis(**WALL, heuristic="optimal", counts=(1, 4))
    found = mcs.convergence(mis, "jittered", [4, 16], realizations=20, rng=1)
    assert np.isfinite(found["rate"])
    terms = mcs.variance_terms(
        mis, "jittered", 16, half_width=2, realizations=20, rng=1, space="primary"
    )
    parts = terms["dc_term"] + terms["power_term"] + terms["cross_term"]
    assert float(parts) == pytest.approx(float(terms["predicted_variance"]), rel=1e-9)


def test_samplers_of_the_renderer_are_candidates():
    given = Setup(mcs.Estimator("pixel(scene='figure1', x=96, y=205)"), as_sampler("random", 2))
    found = candidates_of(given, ("sampler",), Budget(256, 100, Stream.from_rng(1)))
    names = {each if isinstance(each, str) else each.name for each in found}
    assert {f"mitsuba(sampler='{name}')" for name in ("multijitter", "ldsampler")} <= names


def test_remedies_try_every_heuristic_and_each_technique():
    given = Setup(pixel_mis(**PLATE), as_sampler("jittered", 2))
    budget = Budget(256, 100, Stream.from_rng(1))
    others = candidates_of(given, ("heuristic", "techniques"), budget)
    names = {o.partition(": Its")[0] if isinstance(o, str) else o.name for o in others}
    heuristics = {f"heuristic: {h}" for h in HEURISTICS if h != "balance"}
    assert names == heuristics | {"only light", "only bsdf"}


def test_same_techniques_with_another_heuristic():
    mis = pixel_mis(**PLATE, counts=(2, 3), sets="joint")
    other = mis.with_heuristic("power")
    assert (other.counts, other.sets, other.heuristic) == ((2, 3), "joint", "power")
    assert mis.spec == (
        "pixel(scene='veach', x=600, y=430, light='light-3') / balance[2×light, 3×bsdf] "
        "(joint sets)"
    )
    u = uniforms(64)
    np.testing.assert_array_equal(
        mis.alone(1).primary_values(0, u), Pixel(**PLATE, strategy="bsdf")(u)
    )


def test_maps_cover_all_directions():
    pixels = sky_pixels("sky", 64)
    assert pixels.shape == (64, 128, 3)
    assert (pixels > 0).all()


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"heuristic": "maximal"}, "maximum"),
        ({"heuristic": 2}, "heuristic is 2"),
        ({"heuristic": "optimal(pilot='quadrature')"}, "pilot='samples'"),
        ({"heuristic": "optimal(samples=1)"}, "samples"),
        ({"counts": (1,)}, "counts"),
        ({"counts": (1, 0)}, "counts[1]"),
        ({"counts": (1, float("nan"))}, "counts[1]"),
        ({"sets": "same"}, "sets is 'same'"),
        ({"techniques": []}, "techniques is []"),
        ({"techniques": "light"}, "techniques is 'light'"),
        ({"techniques": ["light", 3]}, "'light', 3"),
        ({"techniques": ["bsdf", "bsdf"]}, "at most once"),
        ({"techniques": ["light", "environment"]}, "without 'light'"),
        ({"techniques": ["environment", "bsdf"]}, "no environment to sample"),
        ({"dims": 1}, "dims"),
        ({"x": -1}, "outside the film"),
        ({"channel": 4}, "channel is 4"),
    ],
)
def test_bad_parameters_are_one_sentence(changes, words):
    with pytest.raises(ParameterError) as caught:
        pixel_mis(**{**WALL, **changes})
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)
