"""Randomizations of whole sets: exact invariants, uniform points, exact variances."""

import itertools

import numpy as np
import pytest
from scipy import stats
from scipy.spatial.distance import pdist

import mcspectra as mcs
from mcspectra.core.errors import CountError
from mcspectra.core.streams import Stream
from mcspectra.quality.nets import net_t_value
from mcspectra.samplers import (
    Decorrelate,
    DigitalShift,
    Jittered,
    LatinHypercube,
    Mirror,
    Owen,
    Random,
    RandomRotation,
    Rank1Lattice,
    Shift,
    Sobol,
    StrataShift,
    sampler,
)
from mcspectra.samplers.base import Structure
from mcspectra.samplers.lattice import golden_steps

LEVEL = 1 - (1 - 1e-6) ** (1 / 22)  # Šidák: 22 statistical tests in this file share 1e-6
SIGMAS = stats.norm.isf(LEVEL / 2)
BELOW_ONE = np.nextafter(1.0, 0.0)
EDGES = np.array([0.0, 2.0**-53, 0.25, 0.5 - 2.0**-53, 0.5, 0.5 + 2.0**-53, 0.75, BELOW_ONE])
CLIPPED = RandomRotation(boundary="clipped")
STREAM = Stream.from_rng(42)


@pytest.mark.parametrize(
    "step",
    [
        *(Shift(), StrataShift(), StrataShift(offset=-1e-20), RandomRotation(), CLIPPED),
        *(Mirror(), Mirror(mode="uniform"), Mirror(mode="fold")),
    ],
    ids=lambda step: step.spec,
)
def test_results_stay_below_one_at_the_edges(step):
    edges = np.array([*EDGES, 5e-324, 2.0**-60, 2.0**-33])
    points = np.stack(np.meshgrid(edges, edges), axis=-1).reshape(1, -1, 2)
    moved = step.apply(np.tile(points, (100, 1, 1)), STREAM, 0)
    assert moved.min() >= 0.0
    assert moved.max() < 1.0


@pytest.mark.parametrize(
    ("step", "stationary", "debiases", "strata", "digits", "torus"),
    [
        (Shift(), True, True, "TORUS", "TORUS", "TORUS"),
        (StrataShift(), False, False, "TORUS", "TORUS", "TORUS"),
        (RandomRotation(), False, False, "STRATA", "DIGITS", "TORUS"),
        (CLIPPED, True, True, "TORUS", "TORUS", "TORUS"),
        (Mirror(), False, False, "NONE", "NONE", "NONE"),
        (Mirror(mode="fold"), False, False, "NONE", "NONE", "NONE"),
        (Mirror(mode="uniform"), False, False, "STRATA", "DIGITS", "NONE"),
        (Decorrelate(), True, True, "TORUS", "TORUS", "TORUS"),
        (Decorrelate(mode="digital-shift"), False, True, "STRATA", "DIGITS", None),
        (Decorrelate(mode="owen"), False, True, "STRATA", "DIGITS", None),
    ],
    ids=lambda value: getattr(value, "spec", str(value)),
)
def test_declared_properties(step, stationary, debiases, strata, digits, torus):
    assert (step.stationary, step.debiases) == (stationary, debiases)
    for name, left in (("jittered", strata), ("sobol", digits), ("rank1-lattice", torus)):
        if left is not None:
            moved = sampler(name).then(step)
            assert moved.structure is Structure[left]
            assert moved.unbiased == (debiases or name == "jittered")


def test_shift_keeps_differences_on_the_torus():
    points = Random(dims=3).draw(20, realizations=10, rng=1)
    moved = Shift().apply(points, STREAM, 0)
    difference = (moved - points) - (moved - points)[:, :1]
    np.testing.assert_allclose(difference, np.rint(difference), atol=4 * 2.0**-53)
    assert len(np.unique((moved - points)[:, 0, 0])) == 10


def test_shift_is_uniform_and_its_coordinates_are_independent():
    moved = Shift().apply(np.full((6400, 1, 2), 0.3), STREAM, 0)[:, 0]
    pairs = (np.floor(moved * 8) @ [8, 1]).astype(int)
    assert stats.chisquare(np.bincount(pairs, minlength=64)).pvalue > LEVEL


@pytest.mark.parametrize(
    ("x", "offset", "expected"),
    [
        (BELOW_ONE, 2.0**-53, 0.0),  # the sum is 1
        (BELOW_ONE, 2.0**-54, 0.0),  # the sum rounds to 1
        (BELOW_ONE, BELOW_ONE, 1 - 2.0**-52),
        (0.25, 0.5, 0.75),
        (0.75, 0.5, 0.25),
        (0.0, -0.25, 0.75),
        (0.5, 3.25, 0.75),
        (0.5, -1e-20, 0.5),  # the remainder of −1e-20 rounds to 1
    ],
)
def test_translation_to_the_last_bit(x, offset, expected):
    moved = StrataShift(offset=offset).apply(np.array([[[x]]]), STREAM, 0)
    assert moved.item() == expected


def test_strata_shift_moves_by_a_fraction_of_the_side():
    points = sampler("regular(position='corner')", 2).draw(16)
    moved = StrataShift(offset=[0.5, 0.25]).apply(points, STREAM, 0)
    np.testing.assert_array_equal(moved, (points + np.array([0.125, 0.0625])) % 1.0)
    chained = sampler("regular(position='corner') | strata-shift(offset=[0.5, 0.25])", 2)
    np.testing.assert_array_equal(chained.draw(16), moved)


@pytest.mark.parametrize(
    ("spec", "dims", "n", "expected"),
    [
        ("regular | shift", 1, 16, 1 / (12 * 16**2)),
        ("jittered | shift", 1, 16, 1 / (6 * 16**2) - 1 / (12 * 16**3)),
        ("jittered | shift", 2, 16, 16**-1.5 / 6 - 16**-2 / 12),
    ],
)
def test_variance_of_the_mean_coordinate(spec, dims, n, expected):
    """Exact: a shared offset within 1/n gives 1/(12 n²); independent strata 1/(12 n³)."""
    means = sampler(spec, dims).draw(n, realizations=20_000, rng=8)[..., -1].mean(axis=1)
    centred = means - means.mean()
    error = np.sqrt((np.mean(centred**4) - means.var() ** 2) / len(means))
    assert abs(means.var(ddof=1) - expected) < SIGMAS * error
    assert abs(means.mean() - 0.5) < SIGMAS * np.sqrt(expected / len(means))


def toroidal_distances(points):
    """Return sorted distances of all pairs of (n, d) points."""
    difference = points[:, None] - points[None]
    difference -= np.rint(difference)
    upper = np.triu_indices(len(points), 1)
    return np.sort(np.linalg.norm(difference, axis=-1)[upper])


@pytest.mark.parametrize("dims", [1, 2, 3])
def test_all_symmetries_of_the_cube_are_equally_likely(dims):
    point = np.array([0.1, 0.2, 0.3])[:dims]
    images = [
        tuple(np.where(signs, BELOW_ONE - point[list(order)], point[list(order)]))
        for order in itertools.permutations(range(dims))
        for signs in itertools.product((False, True), repeat=dims)
    ]
    moved = RandomRotation().apply(np.tile(point, (9600, 1, 1)), STREAM, 0)[:, 0]
    counts = np.array([(moved == image).all(axis=1).sum() for image in images])
    assert counts.sum() == 9600
    assert stats.chisquare(counts).pvalue > LEVEL


@pytest.mark.parametrize("spec", ["poisson-disk", "random", "rank1-lattice", "sobol"])
@pytest.mark.parametrize("dims", [2, 3])
def test_toroidal_distances_are_kept(spec, dims):
    source = mcs.sampler(spec, dims)
    plain = source.draw(32, realizations=5, rng=1)
    moved = source.then(RandomRotation()).draw(32, realizations=5, rng=1)
    for before, after in zip(plain, moved, strict=True):
        np.testing.assert_allclose(
            toroidal_distances(after), toroidal_distances(before), atol=8 * 2.0**-53
        )


def test_lattices_stay_lattices():
    """Differences of lattice points are lattice points, so there are n different ones."""
    points = Rank1Lattice(dims=3).then(RandomRotation()).draw(31, realizations=10, rng=2)
    for p in points:
        steps = np.rint((p[:, None] - p[None]) * 31).astype(int) % 31
        assert len(np.unique(steps.reshape(-1, 3), axis=0)) == 31


@pytest.mark.parametrize("sides", [4, 7])
def test_strata_are_kept(sides):
    points = Jittered(dims=2).then(RandomRotation()).draw(sides**2, realizations=40, rng=3)
    cells = np.sort(np.floor(points * sides) @ [sides, 1], axis=1)
    np.testing.assert_array_equal(cells, np.tile(np.arange(sides**2), (40, 1)))


def test_elementary_intervals_are_kept():
    points = Sobol(dims=2).then(RandomRotation()).draw(64, realizations=40, rng=3)
    assert all(net_t_value(set_) == 0 for set_ in points)


@pytest.mark.parametrize("n", [1, 2, 9, 64])
def test_the_window_clips_the_rotated_plane(n):
    """A slow reference: 49 copies of the set in complex numbers, and the n nearest to the center.

    The numbers of a realization are the center, the angle and the final translation.
    """
    plain = mcs.sampler("random", 2).draw(n, realizations=20, rng=5)
    moved = CLIPPED.apply(plain, STREAM, 0)
    shifts = [complex(i, j) for i in range(-3, 4) for j in range(-3, 4)]
    for points, seen, numbers in zip(plain, moved, STREAM.uniforms(0, 20, 5), strict=True):
        center, turn = complex(*numbers[:2]), np.exp(2j * np.pi * numbers[2])
        copies = np.concatenate([points @ [1, 1j] + shift for shift in shifts])
        turned = (copies - center) * turn
        norms = np.maximum(np.abs(turned.real), np.abs(turned.imag))
        nearest = np.argsort(norms)
        window = turned[nearest[:n]] / (2 * norms[nearest[n]]) + complex(0.5, 0.5)
        x = (np.stack([window.real, window.imag], axis=1) + numbers[3:]) % 1.0
        np.testing.assert_allclose(seen[np.argsort(seen[:, 0])], x[np.argsort(x[:, 0])], atol=1e-13)


def test_a_rotated_grid_keeps_its_angles():
    """Without the final translation, all neighbors of a square grid are at right angles."""
    points = mcs.sampler("regular", 2).draw(64, realizations=20, rng=5)
    moved = (CLIPPED.apply(points, STREAM, 0) - STREAM.uniforms(0, 20, 5)[:, None, 3:]) % 1.0
    angles = []
    for p in moved:
        step = p[:, None] - p[None]
        length = np.hypot(step[..., 0], step[..., 1]) + np.eye(64)
        near = step[length < 1.2 * length.min()]
        directions = np.arctan2(near[:, 1], near[:, 0]) * 4
        angles.append(directions[0] % (2 * np.pi) / 4)
        np.testing.assert_allclose(np.exp(1j * (directions - directions[0])), 1.0, atol=1e-9)
        np.testing.assert_allclose(np.hypot(near[:, 0], near[:, 1]), length.min(), rtol=1e-9)
    assert np.ptp(angles) > 0.5


def test_windows_hold_n_different_points_of_the_set():
    """The scale is near 1, so minimum distances change little."""
    source = mcs.sampler("poisson-disk", 2)
    for n in (1, 2, 3, 10, 200):
        plain = source.draw(n, realizations=10, rng=6)
        moved = CLIPPED.apply(plain, STREAM, 0)
        assert len(np.unique(moved.reshape(-1, 2), axis=0)) == 10 * n
    inside = [p[(np.abs(p - 0.5) < 0.5).all(axis=1)] for p in moved]
    assert np.median([pdist(p).min() for p in inside]) < np.median(
        [toroidal_distances(p)[0] for p in plain]
    ) * np.sqrt(200 / 150)


def test_coinciding_points_keep_their_multiplicity():
    doubled = np.repeat(Jittered(dims=2).draw(16, realizations=50, rng=1), 2, axis=1)
    moved = CLIPPED.apply(doubled, STREAM, 0)
    assert moved.shape == doubled.shape
    assert all(16 <= len(np.unique(p, axis=0)) <= 17 for p in moved)


@pytest.mark.parametrize("spec", ["regular", "jittered", "halton"])
def test_clipped_points_are_uniform(spec):
    points = mcs.sampler(f"{spec} | random-rotation(boundary='clipped')", 2).draw(
        4, realizations=6400, rng=9
    )
    cells = (np.floor(points[:, 3] * 8) @ [8, 1]).astype(int)
    assert stats.chisquare(np.bincount(cells, minlength=64)).pvalue > LEVEL


@pytest.mark.parametrize("dims", [1, 2, 3, 64, 65, 130])
def test_random_reflection_reflects_or_not(dims):
    points = Random(dims=dims).draw(50, realizations=20, rng=1)
    moved = Mirror().apply(points, STREAM, 0)
    flipped = moved != points
    np.testing.assert_array_equal(moved[flipped], (BELOW_ONE - points)[flipped])
    # Probability ½, also in pairs of neighboring coordinates, points and realizations
    bits = flipped.ravel().astype(int)
    pairs = 2 * bits[:-1:2] + bits[1::2]
    assert stats.chisquare(np.bincount(pairs, minlength=4)).pvalue > LEVEL / 6


def test_folding_to_the_last_bit():
    ulp = 2.0**-53
    moved = Mirror(mode="fold").apply(EDGES[:, None, None], STREAM, 0).ravel()
    expected = [0.0, 2 * ulp, 0.5, 1 - 2 * ulp, 1 - ulp, 1 - 3 * ulp, 0.5 - ulp, ulp]
    np.testing.assert_array_equal(moved, expected)


def test_folding_is_one_to_one_on_the_grid_and_keeps_points_uniform():
    """A grid of 1,024 multiples of 2^-53 around ½, the only place where both branches meet."""
    grid = 0.5 + np.arange(-512, 512) * 2.0**-53
    moved = Mirror(mode="fold").apply(grid[:, None, None], STREAM, 0)
    assert len(np.unique(moved)) == 1024
    x = Random(dims=1).draw(6400, rng=2)
    cells = np.floor(Mirror(mode="fold").apply(x, STREAM, 0).ravel() * 64).astype(int)
    assert stats.chisquare(np.bincount(cells, minlength=64)).pvalue > LEVEL


@pytest.mark.parametrize("dims", [1, 2, 3])
def test_uniform_mode_holds_all_images_of_each_point(dims):
    n = 3 * 2**dims
    points = Random(dims=dims).draw(3, realizations=4, rng=5)
    moved = Random(dims=dims).then(Mirror(mode="uniform")).draw(n, realizations=4, rng=5)
    images = moved.reshape(4, 3, 2**dims, dims)
    for k, signs in enumerate(itertools.product((False, True), repeat=dims)):
        expected = np.where(signs, BELOW_ONE - points, points)
        np.testing.assert_array_equal(images[:, :, k], expected)


def test_uniform_mode_integrates_odd_functions_exactly():
    """Antithetic: the mean of each coordinate is (1 − 2^-53)/2 up to rounding of sums."""
    moved = mcs.sampler("random | mirror(mode='uniform')", 3).draw(64, realizations=20, rng=1)
    np.testing.assert_allclose(moved.mean(axis=1), 0.5, atol=64 * 2.0**-53)


@pytest.mark.parametrize("sides", [3, 4, 7])
def test_uniform_mode_keeps_strata_and_nets(sides):
    n = 4 * sides**2
    moved = Jittered(dims=2).then(Mirror(mode="uniform")).draw(n, realizations=30, rng=1)
    cells = np.floor(moved * sides).astype(int) @ [sides, 1]
    np.testing.assert_array_equal(
        np.sort(cells, axis=1), np.tile(np.repeat(np.arange(sides**2), 4), (30, 1))
    )
    net = mcs.sampler("sobol | owen | mirror(mode='uniform')", 2).draw(64, realizations=20, rng=2)
    for k in range(5):
        cells = np.floor(net * [2**k, 2 ** (4 - k)]) @ [2 ** (4 - k), 1]
        np.testing.assert_array_equal(
            np.sort(cells, axis=1), np.tile(np.repeat(np.arange(16), 4), (20, 1))
        )


def test_counts_of_the_uniform_mode_are_multiples_of_the_samplers_counts():
    source = Jittered(dims=2).then(Mirror(mode="uniform"))
    assert source.nearest_count(40) == 36
    with pytest.raises(CountError, match="36 and 64") as caught:
        source.draw(40)
    assert caught.value.nearest == (36, 64)
    with pytest.raises(CountError, match="nearest count is 8"):
        LatinHypercube(dims=3).then(Mirror(mode="uniform")).draw(7)
    with pytest.raises(CountError, match=r"from 1 to"):
        source.draw(2**40)


@pytest.mark.parametrize("mask", ["white", "blue-noise", "r2"])
def test_pixels_differ_by_a_translation_only(mask):
    source = Jittered(dims=2).then(Decorrelate(mask=mask, width=16))
    points = source.draw(16, realizations=40, rng=1)
    shared = Jittered(dims=2).draw(16, rng=1)
    moved = points - shared
    steps = moved - moved[:, :1]
    np.testing.assert_allclose(steps, np.rint(steps), atol=4 * 2.0**-53)
    assert len(np.unique(points[:, 0], axis=0)) == 40


@pytest.mark.parametrize(
    ("mode", "step"), [("shift", Shift()), ("digital-shift", DigitalShift()), ("owen", Owen())]
)
def test_white_masks_equal_the_plain_randomization(mode, step):
    """For a fixed set, the shared realization is the set: same points as without decorrelate."""
    np.testing.assert_array_equal(
        Sobol(dims=3).then(Decorrelate(mode=mode)).draw(32, realizations=10, rng=2, first=3),
        Sobol(dims=3).then(step).draw(32, realizations=10, rng=2, first=3),
    )


@pytest.mark.parametrize("mask", ["blue-noise", "r2"])
def test_digital_masks_keep_nets(mask):
    step = Decorrelate(mode="digital-shift", mask=mask, width=8)
    points = Sobol(dims=2).then(step).draw(64, realizations=20, rng=3)
    assert all(net_t_value(set_) == 0 for set_ in points)
    words = [(p * 2.0**53).astype(np.uint64) for p in (points, Sobol(dims=2).draw(64))]
    word = words[0] ^ words[1]
    np.testing.assert_array_equal(word, np.broadcast_to(word[:, :1], word.shape))


def test_blue_noise_shifts_occupy_each_stratum_once():
    width = 16
    step = Decorrelate(mask="blue-noise", width=width)
    for first in (0, width**2, 5 * width):
        offsets = step.offsets(STREAM, first, width**2, 3)
        strata = np.sort(np.floor(offsets * width**2), axis=0)
        np.testing.assert_array_equal(strata, np.arange(width**2)[:, None] + np.zeros(3))


def test_blue_noise_shifts_have_little_power_at_low_frequencies():
    """White shifts have a mean power of 1/12 at every frequency. A tenth of this, below half the
    way
    to the middle of the band, is far more than void and cluster leaves."""
    width = 32
    offsets = Decorrelate(mask="blue-noise", width=width).offsets(STREAM, 0, width**2, 2)
    for image in offsets.T.reshape(2, width, width):
        power = np.abs(np.fft.fft2(image - image.mean())) ** 2 / width**2
        m = np.fft.fftfreq(width, 1 / width)
        radius = np.hypot(m[:, None], m)
        low = (radius > 0) & (radius < width / 8)
        assert power[low].mean() < 0.1 / 12


def test_r2_shifts_step_by_the_golden_vector():
    offsets = Decorrelate(mask="r2").offsets(STREAM, 2**40, 100, 2)
    steps = np.diff(offsets, axis=0) % 1.0
    np.testing.assert_allclose(
        steps, golden_steps(2) * 2.0**-64 + np.zeros((99, 1)), atol=4 * 2.0**-53
    )


@pytest.mark.parametrize("mask", ["blue-noise", "r2"])
def test_points_of_one_pixel_are_uniform_over_seeds(mask):
    step = Decorrelate(mask=mask, width=8)
    offsets = np.concatenate([step.offsets(Stream.from_rng(s), 77, 1, 2) for s in range(3200)])
    cells = (np.floor(offsets * 4) @ [4, 1]).astype(int)
    assert stats.chisquare(np.bincount(cells, minlength=16)).pvalue > LEVEL
    # Points are also uniform within the ranks of the mask
    fine = np.floor(offsets[:, 0] * 64 % 1.0 * 16).astype(int)
    assert stats.chisquare(np.bincount(fine, minlength=16)).pvalue > LEVEL


def test_errors_of_neighbors_are_blue_noise():
    """The image of estimates of x has less low-frequency power than with white shifts."""
    width = 32
    m = np.fft.fftfreq(width, 1 / width)
    radius = np.hypot(m[:, None], m)
    low = (radius > 0) & (radius < 4)
    powers = {}
    for mask in ("white", "blue-noise"):
        spec = f"regular | decorrelate(mask='{mask}', width={width})"
        points = mcs.sampler(spec, 2).draw(4, realizations=width**2, rng=1)
        image = points[..., 0].mean(axis=1).reshape(width, width)
        powers[mask] = np.mean((np.abs(np.fft.fft2(image)) ** 2)[low]) / image.var()
    assert powers["blue-noise"] < 0.5 * powers["white"]


def test_variance_over_pixels_is_that_of_the_shift():
    """Exact: n = 16 equidistant points under a uniform shift, 1/(12 n²) for the mean of x."""
    for mask in ("white", "blue-noise", "r2"):
        spec = f"rank1-lattice | decorrelate(mask='{mask}', width=64)"
        means = mcs.sampler(spec, 1).draw(16, realizations=4096, rng=1)[..., 0].mean(axis=1)
        ratio = means.var(ddof=1) * 12 * 16**2
        assert abs(ratio - 1) < stats.norm.isf(LEVEL / 2) * np.sqrt(0.8 / 4096)


def test_counts_follow_the_mode():
    jittered = Jittered(dims=2)
    for mode, step in (("shift", Shift()), ("digital-shift", DigitalShift()), ("owen", Owen())):
        for n in (16, 30, 36, 60):
            counts = Decorrelate(mode=mode).counts_near(jittered, n)
            assert counts == step.fit(jittered).counts_near(jittered, n)


def test_pixels_of_a_mask_stay_dependent_through_a_chain():
    for mask, independent in (("white", True), ("r2", False), ("blue-noise", False)):
        step = Decorrelate(mask=mask)
        assert step.independent == independent
        assert Sobol(dims=2).then(step).then(Shift()).independent == independent
