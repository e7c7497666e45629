"""Our densities on the environment of a scene: directions, pdfs, and their gains."""

import numpy as np
import pytest
from tests.rendering.samples import mean_and_error, uniforms

import mcspectra as mcs
from mcspectra.core.environments import synthetic_sky
from mcspectra.core.errors import ParameterError
from mcspectra.densities import EnvironmentDensity
from mcspectra.rendering import Pixel, load_mitsuba, load_scene, pixel_mis, sky_pixels
from mcspectra.rendering.skies import Sky, sky_technique

pytestmark = [pytest.mark.render, pytest.mark.usefixtures("coarse_pixels")]

SIGMAS = 4.5
FLOOR = {"x": 8, "y": 8}
ROTATIONS = {"plain": None, "turned": ([0.6, 0.64, -0.48], 70.0)}


def colored_map():
    """A map (16, 32, 3) of smooth positive colors with a bright spot."""
    v, u = np.meshgrid(np.arange(16) / 15, (np.arange(32) + 0.5) / 32, indexing="ij")
    phases = np.array([0.0, 0.3, 0.55])
    waves = 1.5 + np.cos(2 * np.pi * (u[..., None] - phases)) * np.sin(np.pi * v)[..., None]
    spot = 20.0 * np.exp(-((u - 0.3) ** 2 + (v - 0.3) ** 2) / 0.004)
    return np.asarray(waves + spot[..., None] * [1.0, 0.6, 0.2], np.float32)


def open_scene(rotation=None, bsdf=None, lamp=False):
    """A disk under an environment map, without occluders."""
    mitsuba = load_mitsuba()
    transform = mitsuba.ScalarTransform4f
    view = transform().look_at([0, 3, 3], [0, 0, 0], [0, 1, 0])
    sky = {"type": "envmap", "bitmap": mitsuba.Bitmap(colored_map())}
    if rotation is not None:
        sky["to_world"] = transform().rotate(*rotation)
    film = {"type": "hdrfilm", "width": 16, "height": 16}
    scene = {
        "type": "scene",
        "sensor": {"type": "perspective", "fov": 20.0, "to_world": view, "film": film},
        "floor": {
            "type": "disk",
            "to_world": transform().rotate([1, 0, 0], -90).scale(2.0),
            "bsdf": bsdf or {"type": "diffuse", "reflectance": 0.5},
        },
        "sky": sky,
    }
    emitter = {"type": "sphere", "center": [0.0, 3.0, 0.0], "emitter": {"type": "area"}}
    return {**scene, "lamp": emitter} if lamp else scene


@pytest.mark.parametrize("rotation", ROTATIONS.values(), ids=ROTATIONS)
def test_directions_agree_with_the_emitter(rotation):
    """Mitsuba's texels are at θ = π i/(h − 1), φ = 2π (j + ½)/w: there the map is exact."""
    scene, texels = open_scene(rotation), colored_map()
    rows, columns = np.divmod(np.arange(32, 480), 32)  # skip the poles, which belong to all columns
    x = np.stack([(columns + 0.5) / 32, rows / 15], axis=-1)
    directions, _ = Sky(mcs.density("uniform", 2), _matrix(rotation)).sample(x)
    bound = sky_technique(scene, "uniform", "rgb")
    np.testing.assert_allclose(bound.sample(x)[0], directions, atol=1e-6)
    mitsuba = load_mitsuba()
    far = mitsuba.SurfaceInteraction3f()
    far.wi = -mitsuba.Vector3f(*directions.T.astype(np.float32))
    found = np.asarray(load_scene(scene).environment().eval(far).numpy()).T
    np.testing.assert_allclose(found, texels[rows, columns], rtol=1e-3, atol=1e-3)


def _matrix(rotation):
    """Rodrigues' rotation, written out."""
    if rotation is None:
        return np.eye(3)
    (a, b, c), angle = rotation[0], np.radians(rotation[1])
    k = np.array([[0, -c, b], [c, 0, -a], [-b, a, 0]])
    return np.asarray(np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k)


@pytest.mark.parametrize(
    ("density", "rotation"),
    [("environment", None), ("environment(interpolation='bilinear')", ROTATIONS["turned"])],
)
def test_the_pdf_agrees_with_the_samples_and_integrates_to_one(rotation, density):
    sky = sky_technique(open_scene(rotation), density, "rgb")
    directions, own = sky.sample(uniforms(2000))
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1.0, rtol=1e-6)
    # Borders of pixels move by rounding: compare only where the density does not jump
    same = np.isclose(sky.pdf(directions), own, rtol=1e-6)
    assert same.mean() > 0.99
    # ∫ p dω over the sphere by a product rule: Gauss-Legendre in cos θ, trapezoidal rule in φ
    nodes, weights = np.polynomial.legendre.leggauss(200)
    phi = 2 * np.pi * (np.arange(400) + 0.5) / 400
    c, f = np.meshgrid(nodes, phi, indexing="ij")
    s = np.sqrt(1 - c**2)
    sphere = np.stack([s * np.cos(f), s * np.sin(f), c], axis=-1).reshape(-1, 3)
    total = (sky.pdf(sphere).reshape(200, 400).sum(axis=1) * weights).sum() * 2 * np.pi / 400
    assert total == pytest.approx(1.0, abs=2e-3)


def test_the_mean_over_the_sphere_agrees_with_a_constant_sky():
    """A diffuse floor under constant radiance L reflects exactly ρ L for any density."""
    scene = open_scene()
    scene["sky"] = {"type": "constant", "radiance": {"type": "rgb", "value": [0.5, 1.0, 2.0]}}
    for density in (None, "uniform", "environment(interpolation='constant')", "sphere"):
        pixel = Pixel(scene=scene, **FLOOR, strategy="environment", density=density, channel="rgb")
        mean, error = mean_and_error(pixel(uniforms(2**16)))
        assert (np.abs(mean - 0.5 * np.array([0.5, 1.0, 2.0])) < SIGMAS * error).all()


BSDFS = {
    "diffuse": ({"type": "diffuse"}, 2),
    "roughconductor": ({"type": "roughconductor", "alpha": 0.2}, 2),
    "roughplastic": ({"type": "roughplastic", "alpha": 0.2}, 3),
    "principled": (
        {
            "type": "principled",
            "roughness": 0.4,
            "metallic": 0.4,
            "specular": 0.5,
            "clearcoat": 0.5,
        },
        3,
    ),
}
SLOW = {"roughconductor"}  # `principled` has a metallic lobe as well


@pytest.mark.parametrize(
    ("bsdf", "dims"),
    [
        pytest.param(*BSDFS[name], id=name, marks=[pytest.mark.slow] if name in SLOW else [])
        for name in BSDFS
    ],
)
def test_strategies_agree_on_every_bsdf(bsdf, dims):
    """Uses a rotated map, for which the techniques of the plain map would be wrong."""
    place = {"scene": open_scene(ROTATIONS["turned"], bsdf), **FLOOR, "channel": "rgb"}
    wanted, error = mean_and_error(Pixel(**place, strategy="light")(uniforms(2**16)))
    for k, (strategy, needed) in enumerate({"bsdf": dims, "environment": 2}.items()):
        pixel = Pixel(**place, strategy=strategy, dims=needed)
        mean, other = mean_and_error(pixel(uniforms(2**16, pixel.dims, 5 + k)))
        assert (np.abs(mean - wanted) < SIGMAS * np.hypot(error, other)).all()


@pytest.mark.parametrize("name", ["roughplastic", "principled"])
def test_layered_bsdfs_need_a_dim_for_the_lobe(name):
    scene = open_scene(bsdf=BSDFS[name][0])
    with pytest.raises(ParameterError, match="give dims=3"):
        Pixel(scene=scene, **FLOOR, strategy="bsdf")
    with pytest.raises(ParameterError, match="give dims=5"):
        Pixel(scene=scene, **FLOOR, strategy="bsdf", dims=4)


def test_density_of_the_channel_leaves_the_cosine_alone():
    """With its own density a channel is 2π² sin θ cos θ / p, so f/p is ρ/π cos θ times ∫L dω."""
    scene = open_scene()
    for channel in range(3):
        pixel = Pixel(scene=scene, **FLOOR, strategy="environment", channel=channel)
        sky = sky_technique(scene, None, channel)
        u = uniforms(4096)
        cosine = sky.sample(u)[0][:, 1]
        up = cosine > 0.05
        ratio = pixel(u)[up] / cosine[up]
        # The emitter has other rows: a map of 512 rows differs by about 1e-3 at the spot
        assert ratio.std() / ratio.mean() < 5e-3


def test_own_channels_beat_luminance_in_rate_and_by_decades():
    """Blue under a sky with colored patches is continuous with its own density."""
    scene = open_scene()
    pixels = synthetic_sky(32, 64).astype(np.float32)
    scene["sky"]["bitmap"] = load_mitsuba().Bitmap(pixels)
    luminance = "environment(interpolation='constant')"
    found = mcs.convergence(
        [
            Pixel(scene=scene, **FLOOR, strategy="environment", channel=2, density=density)
            for density in (None, luminance)
        ],
        "jittered",
        [64, 256, 1024],
        realizations=60,
        rng=1,
        fit_last=3,
    )
    low, high = found["rate_ci"].values.T
    assert high[0] < low[1]
    own, other = found["variance"].values[:, -1]
    assert np.log10(other / own) > 2.5


def test_channels_by_their_own_densities():
    """Each channel with its own density has the same estimate as all with one density."""
    scene = open_scene()
    mis = pixel_mis(
        scene,
        **FLOOR,
        techniques=[f"environment(interpolation='bilinear', channel={c})" for c in range(3)],
        channel="rgb",
    )
    parts = [mean_and_error(mis.primary_values(t, uniforms(2**15, seed=t))) for t in range(3)]
    one, one_error = mean_and_error(
        Pixel(scene=scene, **FLOOR, channel="rgb")(uniforms(2**17, seed=9))
    )
    error = np.sqrt(sum(e**2 for _, e in parts) + one_error**2)
    assert (np.abs(sum(m for m, _ in parts) - one) < SIGMAS * error).all()


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"density": "environmental"}, "environment"),
        ({"density": 3}, "density in 2 dims"),
        ({"density": mcs.density("uniform", 3)}, "density in 2 dims"),
        ({"density": "environment(channel=5)"}, "channel"),
        ({"density": "environment(path='nowhere.exr')"}, "nowhere.exr"),
        ({"scene": "veach"}, "no environment to sample"),
        ({"light": "floor"}, "no light 'floor'"),
    ],
)
def test_bad_densities_are_one_sentence(changes, words):
    with pytest.raises(mcs.McspectraError) as caught:
        Pixel(**{"scene": open_scene(), **FLOOR, "strategy": "environment", **changes})
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_other_used_lights_are_an_error():
    place = {"scene": open_scene(lamp=True), **FLOOR, "strategy": "environment"}
    with pytest.raises(ParameterError, match="give light='sky'"):
        Pixel(**place)
    with pytest.raises(ParameterError, match="give light='sky'"):
        Pixel(**place, light="lamp")
    assert (Pixel(**place, light="sky")(uniforms(64)) >= 0).all()


def test_map_that_is_scaled_is_refused():
    scene = open_scene()
    scene["sky"]["to_world"] = load_mitsuba().ScalarTransform4f().scale([1.0, 2.0, 1.0])
    with pytest.raises(ParameterError, match="not a rotation"):
        Pixel(scene=scene, **FLOOR, strategy="environment")


@pytest.mark.parametrize("rows", [0, 1, 10**9, 2.5, float("nan")])
def test_rows_of_a_map_are_checked(rows):
    with pytest.raises(ParameterError, match="rows"):
        sky_pixels("sky", rows)


def test_scene_without_environment_has_no_pixels():
    with pytest.raises(ParameterError, match="no environment"):
        sky_pixels("veach")


def test_a_density_object_is_used_unchanged():
    density = EnvironmentDensity(values=colored_map(), channel=1)
    sky = sky_technique(open_scene(), density, "rgb")
    assert isinstance(sky, Sky)
    assert sky.density is density
