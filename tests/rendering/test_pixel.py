"""A pixel compared with the exact irradiance of a sphere, Mitsuba's integrator, and known rates."""

import pickle
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from tests.rendering.samples import mean_and_error, uniforms

import mcspectra as mcs
from mcspectra.cli.main import main
from mcspectra.core.errors import DomainError, ParameterError
from mcspectra.core.registry import Registry
from mcspectra.core.spec import parse
from mcspectra.rendering import (
    Pixel,
    describe_pixel,
    load_mitsuba,
    load_scene,
    pixel_strategies,
)
from mcspectra.rendering import pixel as module
from mcspectra.rendering.pixel import STRATEGIES
from mcspectra.rendering.scenes import film_size
from mcspectra.rendering.techniques import sample_columns

pytestmark = pytest.mark.render

WALL = {"scene": "veach", "x": 568, "y": 100, "light": "light-3"}
PLATE = {"scene": "veach", "x": 600, "y": 430, "light": "light-3"}
OTHERS = ((WALL, 3), (PLATE, 2))
SIGMAS = 4.0
SINGLE = 2e-6  # sixteen roundings of float32, for means with a smaller statistical error


def wall_radiance(position):
    """Reflected radiance of the wall under light-3: ρ L (r/d)² cos θ, exact for a whole sphere."""
    to_light = np.array([3.75, 0.0, 0.0]) - position
    distance = float(np.linalg.norm(to_light))
    return 0.4 * 1.23457 * (0.9 / distance) ** 2 * float(to_light[2]) / distance


def test_every_strategy_has_the_exact_mean():
    """Jittered points: light sampling is precise to 1e-6, the limit of float32."""
    exact = wall_radiance(describe_pixel("veach", 568, 100)["position"])
    points = mcs.sampler("jittered", 2).draw(2**12, realizations=64, rng=1)
    estimates = {name: g(points).mean(axis=1) for name, g in pixel_strategies(**WALL).items()}
    estimates["mis"] = estimates["mis-light"] + estimates["mis-bsdf"]
    for name in ("light", "bsdf", "mis"):
        mean, error = mean_and_error(estimates[name])
        assert abs(mean - exact) < SIGMAS * error + SINGLE * exact, name


def test_the_whole_light_is_visible_from_the_wall_pixel():
    assert (pixel_strategies(**WALL)["light"](uniforms(10_000)) > 0).all()


def test_weights_agree_with_the_heuristics():
    # With the same u, both heuristics weight the same f/p: w = r/(1+r), r²/(1+r²); r = own/other.
    u = uniforms(4096)
    plain = Pixel(**WALL)(u)
    balance, power = (
        Pixel(**WALL, strategy="mis-light", heuristic=h)(u) for h in ("balance", "power")
    )
    w = balance / plain
    assert ((w > 0) & (w < 1)).all()
    np.testing.assert_allclose(power / plain, w**2 / (w**2 + (1 - w) ** 2), rtol=1e-5)


def stock_values(scene, x, y, count):
    """Values (count, 3) of Mitsuba's `direct` integrator along the ray of the pixel's center."""
    mitsuba, loaded = load_mitsuba(), load_scene(scene)
    import drjit  # Mitsuba must come first, because it chooses the LLVM

    width, height = film_size(scene)
    position = mitsuba.Point2f((x + 0.5) / width, (y + 0.5) / height)
    ray, _ = loaded.sensors()[0].sample_ray_differential(0.0, 0.5, position, mitsuba.Point2f(0.5))
    rays = drjit.gather(type(ray), ray, drjit.zeros(mitsuba.UInt32, count))
    sampler = mitsuba.load_dict({"type": "independent"})
    sampler.seed(5, count)
    color, _, _ = mitsuba.load_dict({"type": "direct"}).sample(loaded, sampler, rays)
    return np.asarray(color.numpy(), np.float64).T


@pytest.mark.parametrize(
    ("place", "dims"),
    [(WALL, 2), (PLATE, 3), *(pytest.param(*each, marks=pytest.mark.slow) for each in OTHERS)],
    ids=["wall-2", "plate-3", "wall-3", "plate-2"],
)
def test_all_lights_match_the_stock_integrator(place, dims):
    check_against_stock({**place, "light": None}, dims)


def test_textures_sky_and_layers_match_the_stock_integrator(scene_files):
    check_against_stock({"scene": scene_files["textured"], "x": 20, "y": 15}, 3)


def check_against_stock(place, dims):
    count = 2**18
    wanted, wanted_error = mean_and_error(
        stock_values(place["scene"], place["x"], place["y"], count)
    )
    strategies = pixel_strategies(**place, dims=dims, channel="rgb")
    values = {k: g(uniforms(count, dims, seed=t)) for t, (k, g) in enumerate(strategies.items())}
    values["mis"] = values["mis-light"] + values["mis-bsdf"]
    for name in ("light", "bsdf", "mis"):
        mean, error = mean_and_error(values[name])
        assert (abs(mean - wanted) < SIGMAS * np.hypot(error, wanted_error) + SINGLE * wanted).all()


@pytest.mark.parametrize("strategy", ["light", "bsdf"])  # MIS weights depend on the lights
def test_lights_add_up(strategy):
    place = {"scene": "veach", "x": 600, "y": 430, "strategy": strategy}
    u = uniforms(2**18)
    whole, error = mean_and_error(Pixel(**place)(u))
    single = [mean_and_error(Pixel(**place, light=i)(u)) for i in range(5)]
    total, spread = sum(m for m, _ in single), np.hypot.reduce([e for _, e in single])
    assert abs(total - whole) < SIGMAS * np.hypot(error, spread)


@pytest.mark.parametrize("strategy", STRATEGIES)
def test_shapes_and_channels(strategy):
    u = uniforms(12).reshape(2, 6, 2)
    scalar = Pixel(**PLATE, strategy=strategy)
    color = Pixel(**PLATE, strategy=strategy, channel="rgb")
    values = color(u)
    assert (scalar.dims, scalar.channels, color.channels) == (2, 0, 3)
    assert values.shape == (2, 6, 3)
    assert values.dtype == np.float64
    assert scalar(u[0, 0]).shape == ()
    assert scalar(u[:0]).shape == (0, 6)
    assert color(u[:0]).shape == (0, 6, 3)
    for c in range(3):
        np.testing.assert_array_equal(
            Pixel(**PLATE, strategy=strategy, channel=c)(u), values[..., c]
        )
    rec709 = values @ [0.212671, 0.715160, 0.072169]
    np.testing.assert_allclose(scalar(u), rec709, rtol=1e-5)


def test_light_that_is_never_hit_gives_zeros():
    # light-0 covers about 1e-5 of the wall's hemisphere: none of 16 BSDF samples hits it.
    values = Pixel(**{**WALL, "light": "light-0"}, strategy="bsdf", channel="rgb")(uniforms(16))
    np.testing.assert_array_equal(values, np.zeros((16, 3)))


@pytest.mark.parametrize("strategy", STRATEGIES)
def test_chunks_threads_and_order_do_not_change_bits(monkeypatch, strategy):
    g, u = Pixel(**WALL, strategy=strategy), uniforms(8000).reshape(8, 1000, 2)
    whole = g(u)
    with ThreadPoolExecutor(4) as pool:
        np.testing.assert_array_equal(list(pool.map(g, u)), whole)
    monkeypatch.setattr(module, "CHUNK", 777)
    np.testing.assert_array_equal(g(u[::-1])[::-1], whole)


@pytest.mark.parametrize("strategy", STRATEGIES)
def test_corners_of_the_square_are_finite(strategy):
    ends = np.array([0.0, 2.0**-30, 0.5, 1.0 - 2.0**-53])
    corners = np.stack(np.meshgrid(ends, ends), axis=-1)
    for place in (WALL, PLATE, {**PLATE, "light": None}):
        assert np.isfinite(Pixel(**place, strategy=strategy)(corners)).all()


def test_single_precision_never_rounds_a_sample_up_to_one():
    (samples,) = sample_columns(np.array([[0.0, 0.25, 1.0 - 2.0**-53, 1.0]]).T)
    np.testing.assert_array_equal(samples, [0.0, 0.25, 1.0 - 2.0**-24, 1.0 - 2.0**-24])


@pytest.mark.parametrize("bad", [np.nan, np.inf, -0.1, 1.1])
def test_samples_outside_the_square_are_refused(bad):
    with pytest.raises(DomainError, match="unit cube"):
        Pixel(**WALL)([[0.5, bad]])


def test_samples_of_other_dims_are_refused():
    with pytest.raises(DomainError, match="shape"):
        Pixel(**WALL)(uniforms(4, 3))


def test_spec_string_makes_the_same_pixel():
    registry = Registry("integrand", "none", {"pixel": "mcspectra.rendering.pixel:Pixel"})
    made = Pixel(**PLATE, strategy="mis-bsdf", heuristic="power", channel=1)
    again = registry.build(parse(made.spec), 2)
    assert again == made
    u = uniforms(64)
    np.testing.assert_array_equal(again(u), made(u))
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(made))(u), made(u))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"strategy": "brdf"}, "strategy is 'brdf'"),
        ({"heuristic": "maximum"}, "heuristic is 'maximum'"),
        ({"channel": "red"}, "channel is 'red'"),
        ({"dims": 1}, "dims"),
        ({"dims": 6}, "dims"),
        ({"density": "uniform"}, "density is for strategy='environment'"),
        ({"strategy": "environment"}, "no environment to sample"),
        ({"x": 768}, "outside the film of 'veach': x is 768"),
        ({"y": -1}, "outside the film of 'veach': y is -1"),
        ({"light": "sun"}, "no light 'sun'"),
        ({"light": 9}, "light is 9"),
        ({"x": 642, "y": 72}, "sees the light 'light-3'"),
        ({"scene": "nowhere"}, "no scene called 'nowhere'"),
    ],
)
def test_bad_parameters_are_one_sentence(changes, words):
    with pytest.raises(ParameterError) as caught:
        Pixel(**{**WALL, **changes})
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("scene", "changes", "words"),
    [
        ("dark", {}, "no lights"),
        ("blind", {}, "no camera"),
        ("mirror", {}, "'floor', whose BSDF (SmoothConductor) has a perfectly specular part"),
        ("lamp", {}, "The light 'lamp'"),
        ("lamp", {"light": "lamp"}, "delta function"),
        ("textured", {"strategy": "bsdf"}, "give dims=3"),
        ("mirror", {"y": 0, "x": 0}, "sees nothing"),
        ("textured", {"y": 0, "x": 0}, "sees the light 'sky'"),
    ],
)
def test_pixels_that_are_not_integrands_raise_with_a_reason(scene_files, scene, changes, words):
    with pytest.raises(ParameterError) as caught:
        Pixel(**{"scene": scene_files[scene], "x": 20, "y": 15, **changes})
    assert words in str(caught.value)


def test_a_mirror_hints_at_whole_paths(scene_files, capsys):
    assert main(["pixel", str(scene_files["mirror"]), "20", "15"]) == 2
    assert "measure whole paths with --integrator scene" in capsys.readouterr().err


def test_an_area_light_next_to_a_delta_light_is_allowed(scene_files):
    values = Pixel(scene=scene_files["lamp"], x=20, y=15, light="screen")(uniforms(64))
    assert (values > 0).any()


def test_describe_pixel_shows_lights_and_the_void(scene_files):
    assert describe_pixel("veach", 642, 72)["light"] == "light-3"
    void = describe_pixel(scene_files["mirror"], 0, 0)
    assert set(void.values()) == {None}
    with pytest.raises(ParameterError, match="outside the film"):
        describe_pixel("veach", 768, 0)
