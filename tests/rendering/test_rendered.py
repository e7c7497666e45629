"""Pixels as they are rendered, and samplers that are padded like those of renderers."""

import itertools

import numpy as np
import pytest
from scipy import stats
from tests.rendering.small_scenes import SCENES

from mcspectra.core.errors import ParameterError
from mcspectra.core.streams import Stream
from mcspectra.rendering import load_mitsuba
from mcspectra.rendering.padding import Padded, as_rendered, padding_note, requests_of
from mcspectra.rendering.paths import Dimension, Tracer
from mcspectra.rendering.plugin import joint_sampler, register_samplers
from mcspectra.rendering.rendered import Film, RenderedPixels, chosen_tiles, pixels_of
from mcspectra.rendering.scenes import as_scene
from mcspectra.samplers import as_sampler

USES = (
    Dimension(0, "film", "x"),
    Dimension(0, "film", "y"),
    Dimension(1, "light", "x"),
    Dimension(1, "light", "y"),
    Dimension(1, "lobe"),
    Dimension(1, "direction", "x"),
    Dimension(1, "direction", "y"),
)
LEVEL = 1e-4


def balanced(points, columns, n):
    """Whether every elementary interval of n = 2^m points in these columns holds one point."""
    m = n.bit_length() - 1
    for k in range(m + 1):
        x, y = (points[..., c] for c in columns)
        cells = np.floor(x * 2**k) * 2 ** (m - k) + np.floor(y * 2 ** (m - k))
        if not (np.sort(cells, axis=-1) == np.arange(n)).all():
            return False
    return True


def test_requests_are_pairs_and_single_numbers():
    assert requests_of(USES) == (2, 2, 1, 2)


def test_each_request_has_its_own_even_points():
    padded = as_rendered("sobol | owen", USES, 0)
    x = padded.draw(16, realizations=20, rng=1)
    for columns in ((0, 1), (2, 3), (5, 6)):
        assert balanced(x, columns, 16)
    assert (np.sort(np.floor(x[..., 4] * 16)) == np.arange(16)).all()


def test_padded_requests_are_independent():
    x = as_rendered("sobol", USES, 0).draw(16, realizations=4000, rng=1)
    # Points of both requests in the first halves: hypergeometric, mean 4 of 16 points
    both = ((x[..., 0] < 0.5) & (x[..., 2] < 0.5)).sum(axis=1)
    expected = stats.hypergeom(16, 8, 8)
    found = np.bincount(both, minlength=9)[1:8]
    mass = expected.pmf(np.arange(1, 8))
    assert stats.chisquare(found, found.sum() * mass / mass.sum()).pvalue > LEVEL


def test_nets_take_four_numbers_jointly_by_default():
    padded = as_rendered("sobol | owen", USES)
    assert isinstance(padded, Padded)
    assert padded.joint == 4
    assert "first 4 numbers of a path are joint" in padding_note(padded)
    x = padded.draw(64, realizations=5, rng=1)
    for columns in ((0, 1), (2, 3), (5, 6)):
        assert balanced(x, columns, 64)
    # Jointly, 64 points have t = 2 in four dims: two points in each of 2^4 cells of sides 1/2
    cells = np.floor(x[..., :4] * 2) @ [8, 4, 2, 1]
    assert (np.sort(cells, axis=-1) == np.repeat(np.arange(16), 4)).all()


SHIFTED = "larcher-pillichshammer | digital-shift(jitter=True)"


def test_nets_with_a_jittered_shift_are_joint_by_default_as_well():
    padded = as_rendered(SHIFTED, USES)
    assert isinstance(padded, Padded)
    assert padded.joint == 4
    x = padded.draw(64, realizations=5, rng=1)
    for columns in ((0, 1), (2, 3), (5, 6)):
        assert balanced(x, columns, 64)


@pytest.mark.parametrize("spec", ["jittered", "latin-hypercube", "mitsuba(sampler='ldsampler')"])
def test_other_samplers_are_padded_by_default(spec):
    padded = as_rendered(spec, USES)
    assert isinstance(padded, Padded)
    assert padded.joint == 0
    assert padded.spec == as_sampler(spec, 2).spec
    assert padded.draw(16, realizations=2, rng=1).shape == (2, 16, 7)


def test_all_numbers_may_be_joint():
    whole = as_rendered("sobol | owen", USES, 7)
    drawn = as_sampler("sobol | owen", 7).draw(16, realizations=3, rng=2)
    np.testing.assert_array_equal(whole.draw(16, realizations=3, rng=2), drawn)
    assert as_rendered("random", USES).spec == "random"
    with pytest.raises(ParameterError, match="joint_dims is 1"):
        as_rendered("sobol | owen", USES, 1)


def shift_variance(points):
    """The sum over the dual net in the docstring of `JoinedPairs`, for digits (n, dims, m)."""
    m = points.shape[-1]
    zeros = np.where(points.any(-1), points.argmax(-1), m)[..., None]
    places = np.arange(m)
    # Sum of the Walsh functions with a+1 digits: 2^a, or −2^a if digit a+1 is the first 1
    sums = 2.0**places * ((zeros > places).astype(float) - (zeros == places))
    return (1 + (sums * 4.0 ** -(places + 1)).sum(-1)).prod(-1).mean() - 1


@pytest.mark.parametrize("m", [*range(1, 13), pytest.param(16, marks=pytest.mark.slow)])
def test_linked_points_of_larcher_and_pillichshammer_are_better_than_those_of_sobol(m):
    n, found = 2**m, {}
    for name in ("larcher-pillichshammer", "sobol"):
        x = joint_sampler(as_sampler(f"{name} | owen", 2), 4).base.draw(n, rng=1)[0]
        numbers = (x * n).astype(int)
        digits = (numbers[..., None] >> np.arange(m)[::-1]) & 1
        assert len(np.unique(numbers[:, :2], axis=0)) == n
        assert {tuple(p) for p in numbers[:, :2]} == {tuple(p) for p in numbers[:, 2:]}
        found[name] = shift_variance(digits)
    assert found["larcher-pillichshammer"] <= found["sobol"]


@pytest.mark.parametrize("n", [16, 64, 256])
def test_joined_pairs_are_nets(n):
    x = joint_sampler(as_sampler("sobol | owen", 2), 4).draw(n, realizations=3, rng=1)
    assert balanced(x, (0, 1), n)
    assert balanced(x, (2, 3), n)
    # The quality parameter in four dims, by the number of points in all elementary intervals
    t = {16: 1, 64: 2, 256: 3}[n]
    m = n.bit_length() - 1
    for k in itertools.product(range(m - t + 1), repeat=4):
        if sum(k) == m - t:
            sides = 2 ** np.array(k)
            cells = np.floor(x * sides) @ np.append(np.cumprod(sides[::-1])[-2::-1], 1)
            counts = np.apply_along_axis(np.bincount, 1, cells.astype(int), minlength=n >> t)
            assert (counts == 2**t).all()


@pytest.mark.parametrize(
    ("rfilter", "plugin"),
    [
        ("box", "multijitter"),
        pytest.param("tent", {"type": "mcspectra"}, marks=pytest.mark.slow),
    ],
)
def test_pixels_have_the_mean_and_the_variance_of_images(rfilter, plugin):
    register_samplers()
    mitsuba = load_mitsuba()
    size = {"width": 8, "height": 6, "rfilter": rfilter}
    scene = as_scene(SCENES["plate"](**size))
    film = Film.of(scene)
    tiles, side = chosen_tiles(film, 48, Stream.from_rng(0))
    pixels = pixels_of(tiles, side)
    rendered = RenderedPixels(Tracer(scene, "scene", "luminance", (8, 6)), film)
    found = rendered.estimates(plugin, 16, tiles, side, 60, Stream.from_rng(1))

    given = {"type": plugin} if isinstance(plugin, str) else plugin
    description = SCENES["plate"](**size)
    description["sensor"]["sampler"] = {**given, "sample_count": 16}
    loaded = mitsuba.load_dict(description)
    images = [mitsuba.render(loaded, seed=mitsuba.UInt32(k)) for k in range(60)]
    weights = [0.212671, 0.715160, 0.072169]
    images = np.stack([np.array(image)[..., :3] @ weights for image in images])
    true = images[:, pixels[:, 1], pixels[:, 0]]
    noisy = true.var(axis=0) > 1e-8
    p = stats.ttest_ind(found, true, equal_var=False).pvalue[noisy]
    assert -np.expm1(p.size * np.log1p(-p.min())) > LEVEL
    logs = np.log(found.var(axis=0, ddof=1) / true.var(axis=0, ddof=1))[noisy]
    # Neighbors are correlated by the filter; 4 standard errors of independent pixels suffice
    assert abs(logs.mean()) < 4 * logs.std(ddof=1) / np.sqrt(len(logs))


def test_tiles_cover_all_strata():
    film = Film(640, 480, 0)
    tiles, side = chosen_tiles(film, 300, Stream.from_rng(0))
    assert side == 1
    counts = np.histogram2d(*tiles.T, bins=(4, 3), range=((0, 640), (0, 480)))[0]
    assert counts.min() > 15
    tiles, side = chosen_tiles(Film(640, 480, 2), 320, Stream.from_rng(0))
    assert side == 4
    assert (tiles + side <= (640, 480)).all()
    assert len(chosen_tiles(Film(8, 6, 0), 1024, Stream.from_rng(0))[0]) == 48
