"""Whole paths as integrands: compared with Mitsuba's renders, their coordinates, bad input."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy import stats

import mcspectra as mcs
from mcspectra.core.errors import IncompleteImageWarning, ParameterError
from mcspectra.rendering import (
    builtin,
    check_scene,
    load_mitsuba,
    load_scene,
    map_tiles,
    path_pixel,
    variance_map,
)
from mcspectra.rendering.paths import (
    Dimension,
    find_integrator,
    in_dims,
    light_selection,
    parts_by_light,
)
from mcspectra.rendering.scenes import as_scene, emitter_names

pytestmark = [pytest.mark.render, pytest.mark.usefixtures("coarse_pixels")]

N, REPEATS = 64, 100  # samples per estimate, number of estimates
FALSE_ALARM = 1e-6  # probability for one test over all pixels, for means and variances
Scene = dict[str, Any]


def cornell():
    scene: Scene = dict(load_mitsuba().cornell_box())
    scene["integrator"] = {"type": "path", "max_depth": 5, "rr_depth": 100}
    return scene


def small(scene, width=12, height=8):
    """Return the scene with a small film and a box filter: a pixel's mean is then an integral."""
    film = {"type": "hdrfilm", "width": width, "height": height, "rfilter": {"type": "box"}}
    return scene | {"sensor": scene["sensor"] | {"film": film}}


SCENES: dict[str, tuple[Callable[[], Scene], str, list[tuple[int, int]]]] = {
    "veach": (builtin.veach, "path(max_depth=3)", [(3, 5), (6, 7), (11, 4)]),
    "penumbra": (builtin.penumbra, "path(max_depth=4, rr_depth=2)", [(0, 6), (6, 5), (9, 7)]),
}


def renders(scene, integrator):
    """Luminance of independent renders (R, h, w) by Mitsuba."""
    mitsuba = load_mitsuba()
    import drjit  # Mitsuba must come first, because it chooses the LLVM

    loaded = load_scene(scene)
    made = find_integrator(as_scene(scene), integrator)
    images = [
        mitsuba.render(loaded, integrator=made, spp=N, seed=drjit.opaque(mitsuba.UInt32, 7 + r))
        for r in range(REPEATS)
    ]
    return np.stack([np.asarray(image) for image in images]) @ [0.212671, 0.715160, 0.072169]


@pytest.mark.parametrize("name", [pytest.param("veach", marks=pytest.mark.slow), "penumbra"])
def test_mean_and_variance_agree_with_mitsubas_render(name):
    make, integrator, pixels = SCENES[name]
    scene = small(make())
    theirs = renders(scene, integrator)
    level = stats.norm.isf((1 - (1 - FALSE_ALARM) ** (1 / (2 * len(pixels)))) / 2)
    for x, y in pixels:
        f = path_pixel(scene, x, y, integrator=integrator)
        own = f(mcs.sampler("random", f.dims).draw(N, realizations=REPEATS, rng=11)).mean(axis=1)
        other = theirs[:, y, x]
        assert other.std() > 0  # otherwise there is nothing to compare
        # Welch's test of the values and of their squared deviations
        for a, b in ((own, other), ((own - own.mean()) ** 2, (other - other.mean()) ** 2)):
            assert abs(stats.ttest_ind(a, b, equal_var=False).statistic) < level, (x, y)


def test_coordinates_of_cornells_box_are_found_and_named():
    f = path_pixel(small(cornell()), 6, 5)
    assert f.dims == 2 + 5 * 6
    assert [str(d) for d in f.dimensions[:8]] == [
        "film x", "film y", "bounce 1 light x", "bounce 1 light y", "bounce 1 lobe",
        "bounce 1 direction x", "bounce 1 direction y", "bounce 1 roulette",
    ]  # fmt: skip
    assert [d.bounce for d in f.dimensions] == [0, 0, *np.repeat([1, 2, 3, 4, 5], 6)]
    # The last iteration reaches no light: its numbers are drawn and not used
    u = np.random.default_rng(3).random((2000, f.dims))
    v = u.copy()
    v[:, 26:] = 0.5
    assert np.array_equal(f(u), f(v))
    v[:, 25] = 0.999  # no roulette before the 100th bounce
    assert np.array_equal(f(u), f(v))
    v[:, 20] = 0.3
    assert not np.array_equal(f(u), f(v))


@pytest.mark.parametrize(
    ("integrator", "dims", "decisions"),
    [
        # `test_lens_and_time_come_after_the_film` has this integrator as well
        pytest.param("direct", 7, {"film", "light", "lobe", "direction"}, marks=pytest.mark.slow),
        ("prb(max_depth=3)", 20, {"film", "light", "lobe", "direction", "roulette"}),
        ("depth", 2, {"film"}),
    ],
)
def test_other_integrators(integrator, dims, decisions):
    f = path_pixel(small(cornell()), 6, 5, integrator=integrator)
    assert f.dims == dims
    assert {d.decision for d in f.dimensions} == decisions


def test_lens_and_time_come_after_the_film():
    scene = small(cornell())
    scene["sensor"] |= {
        "type": "thinlens", "aperture_radius": 0.1, "focus_distance": 3.0,
        "shutter_open": 0.0, "shutter_close": 1.0,
    }  # fmt: skip
    f = path_pixel(scene, 6, 5, integrator="direct")
    named = [str(d) for d in f.dimensions[:5]]
    assert named == ["film x", "film y", "lens x", "lens y", "time"]
    u = np.random.default_rng(3).random((500, f.dims))
    v = u.copy()
    v[:, 2] = 0.1
    assert not np.array_equal(f(u), f(v))


def test_an_integrator_of_the_users_own():
    mitsuba = load_mitsuba()

    class Product(mitsuba.SamplingIntegrator):
        def sample(self, scene, sampler, ray, medium=None, active=True):
            u, v = sampler.next_2d(active), sampler.next_1d(active)
            return mitsuba.Color3f(u.x * u.y, v, 1.0), mitsuba.Bool(True), []

    mitsuba.register_integrator("own_product", Product)
    f = path_pixel(small(cornell()), 6, 5, integrator="own_product", channel="rgb")
    u = np.random.default_rng(5).random((100, f.dims))
    assert [str(d) for d in f.dimensions[2:]] == [
        "bounce 1 request 1 x", "bounce 1 request 1 y", "bounce 1 request 2"
    ]  # fmt: skip
    expected = np.stack([u[:, 2] * u[:, 3], u[:, 4], np.ones(100)], axis=-1)
    np.testing.assert_allclose(f(u), expected, rtol=1e-6)


def test_bits_do_not_depend_on_the_chunks(monkeypatch):
    f = path_pixel(small(cornell()), 6, 5)
    u = np.random.default_rng(5).random((1000, f.dims))
    whole = f(u)
    monkeypatch.setattr("mcspectra.rendering.paths._TABLE_NUMBERS", 370 * f.dims)
    assert np.array_equal(f(u), whole)
    assert np.array_equal(np.concatenate([f(u[:1]), f(u[1:])]), whole)
    assert f(u[:0]).shape == (0,)


def test_numbers_beyond_the_dims_are_hashed_without_bias():
    scene, rng = small(cornell()), np.random.default_rng(5)
    whole, cut = (path_pixel(scene, 6, 6, dims=dims) for dims in (None, 8))
    assert cut.dimensions == whole.dimensions[:8]
    u = rng.random((2**16, whole.dims))
    a, b = whole(u), cut(u[:, :8])
    assert np.array_equal(b, cut(u[:, :8]))
    assert not np.array_equal(a, b)
    # 5 σ: both are means of len(u) independent values with the same variance
    error = np.hypot(a.std(), b.std()) / len(u) ** 0.5
    assert abs(a.mean() - b.mean()) < 5 * error
    assert path_pixel(scene, 6, 6, dims=40).dimensions[-1] == Dimension(6, "unknown")


def test_good_points_help_and_the_spec_makes_the_same_integrand():
    scene = "penumbra(width=16, height=12)"
    f = path_pixel(scene, 8, 9, integrator="path(max_depth=3)")
    again = mcs.integrand(f.spec)
    assert again == f
    assert again.dims == f.dims == 20
    found = mcs.convergence(f, ["random", "sobol | owen"], (16, 256), realizations=100)
    low, high = (found["variance_ci"].isel(n=-1, bound=k) for k in (0, 1))
    assert float(high[1]) < float(low[0])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"integrator": "nosuch"}, "not found"),
        ({"integrator": "path(bogus=1)"}, "unreferenced property"),
        ({"integrator": "path(max_depth="}, "cannot be read"),
        ({"integrator": "ptracer"}, "cannot follow a ray"),
        ({"integrator": "diffuse"}, "cannot follow a ray"),
        ({"integrator": 3}, "integrator is 3"),
        ({"x": 12}, "outside the film"),
        ({"dims": 1}, "from 2 to 1024"),
        ({"dims": 10**6}, "from 2 to 1024"),
        ({"channel": "hue"}, "channel"),
        (
            {"selection": (1, 1)},
            "selection has 2 values; give a positive number for each of the lights",
        ),
        ({"selection": -1.0}, "greater than 0"),
        ({"scene": "penumbra", "integrator": None}, "names no integrator"),
    ],
)
def test_bad_input_is_one_sentence(change, message):
    given = {"scene": small(cornell()), "x": 6, "y": 5} | change
    with pytest.raises(ParameterError, match=message) as caught:
        path_pixel(**given)
    assert "\n" not in str(caught.value)


def test_a_pixel_of_a_map_agrees_with_convergence(monkeypatch):
    scene: Any = small(cornell())
    given: dict[str, Any] = {"integrator": "path(max_depth=3)", "realizations": 16, "rng": 9}
    f = path_pixel(scene, 6, 5, integrator="path(max_depth=3)")
    given["joint_dims"] = f.dims  # All numbers of a path come from one set, as in `f`
    whole = variance_map(scene, crop=(4, 3, 6, 5), **given)
    assert whole.attrs["integrator"] == "path(max_depth=3)"
    assert whole["n"].values.tolist() == [4, 16, 64]
    alone = mcs.convergence(f, "sobol | owen", (4, 16, 64), realizations=16, rng=9)
    # The same values, added up in another order
    ours = whole.sel(x=6, y=5)
    np.testing.assert_allclose(alone["variance"], ours["variance"][0], rtol=1e-12)
    assert float(ours["mean"][0]) == pytest.approx(float(alone["mean"][-1]), rel=1e-12)
    monkeypatch.setattr(map_tiles, "TILE_LANES", 16 * 7)
    in_tiles = variance_map(scene, crop=(5, 4, 4, 3), **given)
    one = variance_map(scene, crop=(6, 5, 1, 1), **given)
    part = whole.isel(x=slice(1, 5), y=slice(1, 4))
    np.testing.assert_array_equal(in_tiles["variance"], part["variance"])
    np.testing.assert_array_equal(one["variance"][..., 0, 0], whole["variance"].sel(x=6, y=5))


def test_shares_of_a_map_agree_with_anova():
    scene: Any = small(cornell())
    given: dict[str, Any] = {
        "integrator": "path(max_depth=3)",
        "counts": (4, 16),
        "realizations": 4,
    }
    whole = variance_map(scene, crop=(5, 4, 3, 2), chains=1000, rng=9, points="own", **given)
    place = whole.sel(x=6, y=5)
    f = path_pixel(scene, 6, 5, integrator="path(max_depth=3)")
    groups = [d.bounce for d in f.dimensions]
    parts = mcs.anova_variances(f, order=1, groups=groups, realizations=2000, rng=4)
    up_to, ends = parts["truncation_share"].values, parts["truncation_share_ci"].values
    own, own_ends = np.cumsum(place["bounce_share"]), place["bounce_share_ci"].values
    assert place["bounce"].values.tolist() == [0, 1, 2, 3]
    assert place["decision"].values.tolist() == ["film", "light", "lobe", "direction", "roulette"]
    # Half widths of both; for sums the sum of the widths, at 2.5 times 95 %
    half = np.cumsum(np.diff(own_ends)[:, 0]) / 2 + np.diff(ends)[:, 0] / 2
    assert (np.abs(own - up_to) <= 2.5 * half + 1e-12).all()
    for kind in ("bounce", "decision"):
        np.testing.assert_allclose(whole[f"{kind}_share"].sum(kind), 1.0, rtol=1e-12)
    # The variance of a path is n times the variance of a mean of n random paths
    random = f(mcs.sampler("random", f.dims).draw(1, realizations=10_000, rng=1))[:, 0]
    squares = (random - random.mean()) ** 2
    error = np.hypot(squares.std() / 10_000**0.5, float(place["path_variance_se"]))
    assert abs(float(place["path_variance"]) - squares.mean()) < 4 * error
    # A single pixel equals the same pixel among others, and no pixel has shares without chains
    one = variance_map(scene, crop=(6, 5, 1, 1), chains=1000, rng=9, points="own", **given)
    np.testing.assert_array_equal(one["bounce_share_ci"][:, 0, 0], place["bounce_share_ci"])
    assert "bounce_share" not in variance_map(scene, crop=(6, 5, 1, 1), chains=0, **given)


def test_samplers_are_compared_at_each_pixel():
    given: dict[str, Any] = {
        "integrator": "path(max_depth=2)", "crop": (2, 5, 6, 3), "counts": (4, 64),
        "realizations": 100, "rng": 2, "points": "own", "chains": 8,
    }  # fmt: skip
    scene: Any = small(builtin.penumbra(), 12, 8)
    both = variance_map(scene, sampler=["random", "sobol | owen"], **given)
    alone = variance_map(scene, sampler="sobol | owen", **given | {"chains": 0})
    assert both["sampler"].values.tolist() == ["random", "sobol | owen"]
    np.testing.assert_array_equal(both["variance"][1], alone["variance"])
    assert both["bounce_share"].dims == ("bounce", "y", "x")
    ratio = np.log(both["variance"][0, 0, -1] / both["variance"][1, 0, -1]).values
    half = 1.96 * np.hypot(*both["variance_relative_se"][:, 0, -1].values)
    decided = np.where(ratio > half, 1.0, np.where(-ratio > half, 0.0, -1.0))
    np.testing.assert_array_equal(both["best_sampler"][0], decided)
    assert (decided == 1.0).mean() > 0.5
    summary = both.mcspectra.summary()
    assert summary.count("Surely least variance at") == 1
    assert summary.startswith("Use sobol | owen: ")
    assert "Cause: most variance comes from" in summary
    assert len(both.mcspectra.plot("map-variance")) == 2


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"chains": 3}, "at least 8"),
        ({"chains": -1}, "chains"),
        ({"integrator": None, "chains": 64}, "chains is for whole paths"),
        ({"heuristic": "power"}, "heuristic is for direct light"),
        ({"sampler": ["random", "random"]}, "several that differ"),
        ({"sampler": []}, "several that differ"),
        ({"light": 0}, "light is for direct light"),
        ({"strategies": ("light",)}, "strategies is for direct light"),
        ({"integrator": "ptracer"}, "cannot follow a ray"),
        ({"sampler": "jittered", "joint_dims": 4}, "cannot make 4 points"),
        ({"integrator": None, "dims": 4}, "from 2 to 3"),
    ],
)
def test_a_map_refuses_in_one_sentence(change, message):
    with pytest.raises(ParameterError, match=message) as caught:
        variance_map(**({"scene": small(cornell()), "integrator": "path"} | change))
    assert "\n" not in str(caught.value)


def test_direct_light_of_a_scene_with_a_path_integrator_warns():
    scene = cornell()
    given: dict[str, Any] = {"crop": (9, 5, 2, 2), "counts": (4, 16), "realizations": 4}
    with pytest.warns(IncompleteImageWarning, match=r"PathIntegrator.*direct light alone"):
        found = variance_map(small(scene), **given)
    assert "direct light alone" in found.attrs["scene_note"]
    assert [s for s in check_scene(small(scene)) if "PathIntegrator" in s]
    # No warning if the integrator is measured, is direct, or is missing: warnings are errors here
    assert not variance_map(small(scene), integrator="scene", **given).attrs["scene_note"]
    wide = small(scene)
    wide["sensor"]["film"] |= {"rfilter": {"type": "gaussian"}}
    note = variance_map(wide, integrator="scene", **given).attrs["scene_note"]
    assert "GaussianFilter" in note
    scene["integrator"] = {"type": "direct"}
    variance_map(small(scene), **given)
    del scene["integrator"]
    assert not check_scene(small(scene))


LAMPS = "veach(width=48, height=32)"


def test_parts_of_lights_sum_to_the_pixel_and_agree_with_each_light_alone():
    scene = small(builtin.veach(), 48, 32)
    f = path_pixel(scene, 24, 26, integrator="path(max_depth=4)")
    u = np.random.default_rng(3).random((2**14, f.dims))
    values, parts = f(u), parts_by_light(f, u)
    rounding = 1e-5 * values.max()
    np.testing.assert_allclose(parts.sum(axis=0), values, rtol=0, atol=rounding)
    # In scenes whose other lights are black, paths are chosen in the same way
    lights = [name for name, part in scene.items() if isinstance(part, dict) and "emitter" in part]
    assert len(parts) == len(lights) == len(emitter_names(as_scene(scene)))
    named = list(zip(emitter_names(as_scene(scene)), parts, strict=True))
    for kept, part in (named[0], named[-1]):
        black = {"type": "area", "radiance": {"type": "rgb", "value": 0.0}}
        dark = {name: scene[name] | {"emitter": black} for name in lights if name != kept}
        alone = path_pixel(scene | dark, 24, 26, integrator="path(max_depth=4)")
        np.testing.assert_allclose(part, alone(u), rtol=0, atol=rounding)
    # The scene is unchanged
    assert np.array_equal(f(u), values)


def test_lights_chosen_by_second_moments_have_the_theoretical_variance():
    """For light sampling, f = h_J/p_J: Σ p E f_j² becomes (Σ √(p E f_j²))²; 5 standard errors."""
    integrator = "direct(emitter_samples=1, bsdf_samples=0)"
    f = path_pixel(LAMPS, 24, 26, integrator=integrator)
    rng = np.random.default_rng(4)
    parts = parts_by_light(f, rng.random((2**17, f.dims)))
    moments = light_selection(f.scene) * (parts**2).mean(axis=1)
    best = path_pixel(LAMPS, 24, 26, integrator=integrator, selection=np.sqrt(moments))
    values = best(rng.random((2**17, f.dims)))
    mean, expected = parts.sum(axis=0).mean(), np.sqrt(moments).sum() ** 2
    before = parts.sum(axis=0)
    assert abs(values.mean() - mean) < 5 * np.hypot(values.std(), before.std()) / len(values) ** 0.5
    # Errors of both second moments; by Jensen, that of the squared sum is at most that of f²
    error = np.hypot((values**2).std(), (before**2).std()) / len(values) ** 0.5
    assert abs((values**2).mean() - expected) < 5 * error
    assert (values**2).mean() + 5 * error < (before**2).mean()


def test_roulette_costs_fewer_numbers():
    def asked(rr_depth):
        integrator = f"path(max_depth=4, rr_depth={rr_depth})"
        return path_pixel(small(cornell()), 6, 6, integrator=integrator).numbers_per_path

    assert asked(1) < asked(3) < asked(100)


@pytest.mark.parametrize(
    "spec", ["halton | owen", "faure | owen | shift", "sobol | owen | decorrelate"]
)
def test_samplers_in_other_dims_agree_with_their_spec(spec):
    made, other = in_dims(mcs.sampler(spec, 2), 5), mcs.sampler(spec, 5)
    assert made == other
    points = made.draw(25 if "faure" in spec else 16, realizations=2, rng=1)
    assert np.array_equal(points, other.draw(points.shape[1], realizations=2, rng=1))
