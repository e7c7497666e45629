"""Built-in scenes: views of their named pixels, and light compared with Lambert's formula."""

import math

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.core.environments import synthetic_sky
from mcspectra.core.errors import ParameterError
from mcspectra.rendering import (
    SCENES,
    Pixel,
    check_scene,
    describe_pixel,
    load_mitsuba,
    load_scene,
    named_pixels,
    project,
)
from mcspectra.rendering.builtin import P, Q, penumbra

pytestmark = pytest.mark.render

SEEN = {
    "figure1": {"P": "floor", "Q": "floor"},
    "smooth-light": {"P": "floor", "Q": "floor"},
    "penumbra": dict.fromkeys(("lit", "ball", "both", "rod", "blades"), "floor"),
    "sky": {
        "floor": "floor",
        "contact": "floor",
        "diffuse": "diffuse",
        "plastic": "plastic",
        "metal": "metal",
    },
    "veach": {"wall": "wall", "floor": "floor", **{f"plate-{i}": f"plate-{i}" for i in range(4)}},
}
LIGHT = np.array([[-1.0, 2.0, -1.0], [1.0, 2.0, -1.0], [1.0, 2.0, 1.0], [-1.0, 2.0, 1.0]])
RADIANCE, REFLECTANCE = 9.0, 0.5
SINGLE = 2e-6  # sixteen roundings of float32
SIGMAS = 4.0


def occluder():
    """Return the corners of the square of half side 0.7 around (1.5, 1, 0), rotated by 25°."""
    # A rotation about y moves +x toward −z.
    turn = math.radians(-25.0) + np.array([1, 3, 5, 7]) * math.pi / 4
    x, z = 0.7 * math.sqrt(2) * np.array([np.cos(turn), np.sin(turn)])
    return np.stack([1.5 + x, np.ones(4), z], axis=-1)


def radiance(point, polygon):
    """Radiance below a polygon by Lambert's formula, ρ/π · L · ½ Σ angle · (edge normal)_y."""
    to = polygon - point
    to = to / np.linalg.norm(to, axis=1, keepdims=True)
    total = 0.0
    for a, b in zip(to, np.roll(to, -1, axis=0), strict=True):
        normal = np.cross(a, b)
        total += math.acos(float(a @ b)) * normal[1] / float(np.linalg.norm(normal))
    return REFLECTANCE / math.pi * RADIANCE * abs(total) / 2


def clipped(polygon, shadow):
    """Clip a convex polygon by another, both in y = 2 (Sutherland & Hodgman 1974)."""
    center = shadow.mean(axis=0)
    for a, b in zip(shadow, np.roll(shadow, -1, axis=0), strict=True):
        inward = np.cross(b - a, [0.0, 1.0, 0.0])
        inward *= np.sign(inward @ (center - a))
        kept = []
        for p, q in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
            s, t = inward @ (p - a), inward @ (q - a)
            kept += [p] if s >= 0 else []
            kept += [p + (q - p) * s / (s - t)] if s * t < 0 else []
        polygon = np.array(kept)
    return polygon


def seen_part(point):
    """Reflected radiance of a floor point, and the fraction of the light's area visible from it."""
    # twice the height gives twice the distance
    hidden = clipped(LIGHT, point + 2.0 * (occluder() - point))
    if len(hidden) < 3:
        return radiance(point, LIGHT), 1.0
    x, z = hidden[:, 0], hidden[:, 2]
    area = abs(float(x @ np.roll(z, -1) - z @ np.roll(x, -1))) / 2
    return radiance(point, LIGHT) - radiance(point, hidden), 1.0 - area / 4.0


def pixel(name, strategy, scene="figure1"):
    x, y = named_pixels(scene)[name]
    return Pixel(scene=scene, x=x, y=y, strategy=strategy)


def jittered(strata, realizations=40):
    return mcs.sampler("jittered", 2).draw(strata**2, realizations=realizations, rng=1)


@pytest.mark.parametrize("scene", list(SEEN))
@pytest.mark.parametrize("size", ["", "(width=150, height=100)"])
def test_named_pixels_show_the_intended_points(scene, size):
    found = named_pixels(scene + size)
    seen = {name: describe_pixel(scene + size, *xy)["shape"] for name, xy in found.items()}
    assert seen == SEEN[scene]


@pytest.mark.parametrize("scene", list(SEEN))
def test_built_in_scenes_are_supported(scene):
    assert check_scene(scene) == []
    assert SEEN.keys() <= set(SCENES)


def test_named_pixels_outside_a_narrow_film_are_left_out():
    assert set(named_pixels("veach(width=20, height=100)")) == {"floor"}


@pytest.mark.parametrize("strategy", ["light", "bsdf"])
@pytest.mark.parametrize("name", ["P", "Q"])
def test_figure1_has_the_exact_radiance(name, strategy):
    g = pixel(name, strategy)
    position = np.array(describe_pixel("figure1", g.x, g.y)["position"])
    exact, _ = seen_part(position * [1, 0, 1])
    means = g(jittered(64)).mean(axis=1)
    error = means.std(ddof=1) / math.sqrt(len(means))
    assert error < 2e-3 * exact
    assert abs(means.mean() - exact) < SIGMAS * error + SINGLE * exact


def test_the_light_is_fully_visible_from_p_and_partly_from_q():
    u = jittered(128, realizations=1)[0]
    assert (pixel("P", "light")(u) > 0).all()
    g = pixel("Q", "light")
    position = np.array(describe_pixel("figure1", g.x, g.y)["position"])
    _, share = seen_part(position * [1, 0, 1])
    assert 0.2 < share < 0.9
    # Only strata that the shadow's border crosses have errors: at most 2 · 128, ½ each.
    assert abs(np.mean(g(u) > 0) - share) < SIGMAS * 0.5 * math.sqrt(2 * 128) / 128**2


def test_named_points_agree_with_the_module():
    for name, point in (("P", P), ("Q", Q)):
        x, y = project("figure1", point)
        assert named_pixels("figure1")[name] == (math.floor(x), math.floor(y))


def smooth_radiance(point, edge):
    """Reflected radiance under the smooth-edged light, by Gauss-Legendre on each smooth part."""
    nodes, weights = np.polynomial.legendre.leggauss(24)
    borders = np.array([-1.0, edge - 1.0, 1.0 - edge, 1.0])
    half = np.diff(borders) / 2
    x = (half[:, None] * nodes + (borders[:-1] + half)[:, None]).ravel()
    t = np.minimum((1.0 - np.abs(x)) / edge, 1.0)
    w = (half[:, None] * weights).ravel() * t**2 * (3.0 - 2.0 * t)
    squared = 4.0 + (x[:, None] - point[0]) ** 2 + (x[None, :] - point[2]) ** 2
    return REFLECTANCE / math.pi * RADIANCE * float(w @ (4.0 / squared**2) @ w)


@pytest.mark.parametrize("strategy", ["light", "bsdf"])
@pytest.mark.parametrize("edge", [0.2, 1.0])
def test_smooth_edge_follows_its_profile(edge, strategy):
    scene = f"smooth-light(edge={edge})"
    g = pixel("P", strategy, scene)
    position = np.array(describe_pixel(scene, g.x, g.y)["position"])
    exact = smooth_radiance(position, edge)
    means = g(jittered(64)).mean(axis=1)
    error = means.std(ddof=1) / math.sqrt(len(means))
    # Bilinear texels of width 2/256: the profile's second derivative is at most 6/edge².
    bilinear = 2 * (6.0 / edge**2) * (2 / 256) ** 2 / 8
    assert abs(means.mean() - exact) < SIGMAS * error + bilinear * exact


SHADES: dict[str, set[str]] = {
    "lit": set(),
    "ball": {"ball"},
    "both": {"ball", "rod"},
    "rod": {"rod"},
    "blades": {"blade-0", "blade-1"},
}


@pytest.mark.parametrize("name", list(SHADES))
def test_penumbrae_belong_to_their_occluders(name):
    full, (x, y) = penumbra(), named_pixels("penumbra")[name]
    u = jittered(64, realizations=1)[0]
    seen = Pixel(scene=full, x=x, y=y)(u) > 0
    assert name == "lit" or 0.2 < seen.mean() < 0.9
    for shape in full.keys() - {"type", "sensor", "light", "floor"}:
        without = {key: value for key, value in full.items() if key != shape}
        changes = bool((seen != (Pixel(scene=without, x=x, y=y)(u) > 0)).any())
        assert changes == (shape in SHADES[name])


def test_edge_of_width_zero_is_the_constant_light():
    u = jittered(16)
    x, y = named_pixels("figure1")["P"]
    hard = Pixel(scene="figure1(edge=0)", x=x, y=y)
    np.testing.assert_array_equal(hard(u), pixel("P", "light")(u))
    # the edge is narrower than a texel
    thin = Pixel(scene="figure1(edge=5e-324)", x=x, y=y, strategy="bsdf")
    np.testing.assert_allclose(thin(u), pixel("P", "bsdf")(u), rtol=1e-5)


def test_the_sky_is_the_synthetic_one_with_its_first_row_up():
    mitsuba, sky = load_mitsuba(), load_scene("sky").emitters()[0]
    pixels = synthetic_sky(64, 128)
    for row, column in ((3, 10), (20, 80), (45, 100)):
        # Rows go from pole to pole; the centers of columns are half a column from the border.
        theta, phi = math.pi * row / 63, 2 * math.pi * (column + 0.5) / 128
        away = (math.sin(theta) * math.sin(phi), math.cos(theta), -math.sin(theta) * math.cos(phi))
        at = mitsuba.SurfaceInteraction3f()
        at.wi = -mitsuba.Vector3f(*away)
        np.testing.assert_allclose(np.ravel(sky.eval(at).numpy()), pixels[row, column], rtol=2e-5)


@pytest.mark.parametrize(
    ("scene", "words"),
    [
        ("figure1(edge=-0.1)", "edge is -0.1"),
        ("figure1(edge=1.5)", "edge is 1.5"),
        ("figure1(edge='soft')", "edge is 'soft'"),
        ("figure1(edge=None)", "edge is None"),
        ("smooth-light(edge=True)", "edge is True"),
        ("figure1(width=0)", "width is 0"),
        ("sky(height=1e9)", "height is"),
        ("penumbra(width=10**9)", ""),
        ("penumbra(width=1000000000)", "width is 1000000000"),
    ],
)
def test_bad_parameters_are_one_sentence(scene, words):
    with pytest.raises(ParameterError) as caught:
        load_scene(scene)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)
