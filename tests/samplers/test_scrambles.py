"""Randomizations of digits: exact invariants in every base, uniform digits, counts."""

from fractions import Fraction

import numpy as np
import pytest
from scipy import stats

from mcspectra.core.errors import CountError, ParameterError
from mcspectra.core.streams import Stream
from mcspectra.quality.nets import elementary_intervals, net_t_value
from mcspectra.samplers import DigitalShift, Lms, Owen, Permute, Random, _scramble_kernels, sampler

LEVEL = 1 - (1 - 1e-6) ** (1 / 120)  # Šidák: fewer than 120 statistical tests here share 1e-6
SIGMAS = stats.norm.isf(LEVEL / 2)
BELOW_ONE = np.nextafter(1.0, 0.0)
STREAM = Stream.from_rng(42)
SEED = 11
HASH = "owen(method='hash')"
BINARY = ["digital-shift", "permute", "owen", HASH, "lms", "lms(shift=False)"]
SCRAMBLES = [spec for spec in BINARY if spec != HASH]  # scrambles for any base
PRIMES = [3, 5, 7, 13, 29, 53, 97]


def scrambled(steps, points, first=0):
    """Apply one step to the same points (n,) in many realizations: (R, n)."""
    realizations = 4000
    tiled = np.tile(np.asarray(points)[:, None], (realizations, 1, 1))
    return steps.apply(tiled, STREAM, first)[..., 0]


def digits_of(x, base, places):
    """Return the first digits of a float exactly, since a float is a fraction."""
    v = int(Fraction(float(x)) * base**places)
    return [v // base ** (places - 1 - k) % base for k in range(places)]


@pytest.mark.parametrize("step", BINARY)
@pytest.mark.parametrize("net", ["sobol", "niederreiter", "larcher-pillichshammer", "pmj02"])
def test_binary_nets_stay_nets(net, step):
    source = sampler(f"{net} | {step}", 2)
    for bits in (1, 4, 8):
        for points in source.draw(2**bits, realizations=30, rng=bits):
            assert net_t_value(points) == 0


@pytest.mark.parametrize("step", SCRAMBLES)
@pytest.mark.parametrize(("base", "dims", "places"), [(2, 2, 6), (3, 3, 5), (5, 4, 3), (11, 3, 2)])
def test_faure_nets_stay_nets_in_their_base(step, base, dims, places):
    source = sampler(f"faure(base={base}) | {step}", dims)
    for points in source.draw(base**places, realizations=20, rng=3):
        assert elementary_intervals(points, base, 0)


@pytest.mark.parametrize(("base", "dims", "places"), [(2, 2, 6), (3, 3, 5), (11, 3, 2)])
def test_shifts_with_jitter_keep_nets(base, dims, places):
    source = sampler(f"faure(base={base}) | digital-shift(jitter=True)", dims)
    for points in source.draw(base**places, realizations=20, rng=3):
        assert elementary_intervals(points, base, 0)


def test_jitter_is_uniform_and_independent_in_the_intervals_of_points():
    source = sampler("larcher-pillichshammer | digital-shift(jitter=True)", 2)
    assert source.unbiased
    assert source.spec == "larcher-pillichshammer | digital-shift(jitter=True)"
    drawn = source.draw(16, realizations=2000, rng=5)
    np.testing.assert_array_equal(source.draw(16, realizations=2, rng=5, first=7), drawn[7:9])
    place = drawn * 16.0 % 1.0
    assert stats.kstest(place.ravel()[:20_000], "uniform").pvalue > LEVEL
    assert abs(np.corrcoef(place[:, 0, 0], place[:, 1, 0])[0, 1]) < SIGMAS / np.sqrt(2000)
    # Each axis is stratified: the mean of x has the variance 1 / (12 n³)
    variance = drawn[..., 0].mean(axis=1).var(ddof=1)
    assert variance * 12.0 * 16.0**3 == pytest.approx(1.0, abs=SIGMAS * np.sqrt(2.0 / 2000))
    # All points share one shift: the places of points i and j differ by the same digits
    cells = np.floor(drawn * 16.0).astype(int)
    fixed = np.floor(sampler("larcher-pillichshammer", 2).draw(16)[0] * 16.0).astype(int)
    np.testing.assert_array_equal(cells ^ cells[:, :1], np.tile(fixed ^ fixed[:1], (2000, 1, 1)))


@pytest.mark.parametrize("step", SCRAMBLES)
@pytest.mark.parametrize("base", [2, *PRIMES])
def test_every_interval_of_an_axis_in_floats(step, base):
    """Any n points of the radical inverse are alone in their b^-m, by ⌊x b^m⌋ in floats."""
    source = sampler(f"van-der-corput(base={base}) | {step}")
    places = int(np.log(5000) / np.log(base) + 1e-9)
    for n in (base**places, base**places - 1, base):
        boxes = np.floor(source.draw(n, realizations=20, rng=base)[..., 0] * float(base**places))
        assert min(len(np.unique(row)) for row in boxes) == n


@pytest.mark.parametrize("step", [spec for spec in SCRAMBLES if "lms" not in spec])
@pytest.mark.parametrize("base", [4, 6, 9, 64, 96])
def test_composite_bases(step, base):
    source = sampler(f"van-der-corput(base={base}) | {step}")
    for points in source.draw(base**2, realizations=20, rng=base)[..., 0]:
        np.testing.assert_array_equal(np.sort(np.floor(points * base**2)), np.arange(base**2))


@pytest.mark.parametrize("step", SCRAMBLES)
def test_halton_boxes(step):
    points = sampler(f"halton | {step}", 3).draw(8 * 9 * 5, realizations=50, rng=6)
    boxes = np.sort(np.floor(points * [8, 9, 5]) @ [45, 5, 1], axis=1)
    np.testing.assert_array_equal(boxes, np.broadcast_to(np.arange(360), boxes.shape))


def test_scrambles_of_scrambles():
    points = sampler("faure | owen | permute | digital-shift | lms", 3).draw(
        3**6, realizations=20, rng=8
    )
    assert all(elementary_intervals(set_, 3) for set_ in points)


@pytest.mark.parametrize("spec", ["halton", "halton(scramble='owen')", "faure(base=97)"])
def test_boxes_survive_further_scrambles(spec):
    source = sampler(f"{spec} | owen | permute", 2)
    b1, b2 = source.digit_bases
    for points in source.draw(b1 * b2, realizations=50, rng=9):
        if b1 == b2:
            assert elementary_intervals(points, b1)
        else:
            boxes = np.floor(points * [b1, b2]) @ [b2, 1]
            np.testing.assert_array_equal(np.sort(boxes), np.arange(b1 * b2))


@pytest.mark.parametrize("base", [3, 7, 10])
def test_digital_shift_adds_digits_modulo_the_base(base):
    places = 5
    n = base**2
    points = sampler(f"van-der-corput(base={base})").draw(n)[0, :, 0]
    moved = DigitalShift(base=base).apply(points[None, :, None], STREAM, 0)[0, :, 0]
    numbers = [digits_of_index(k, base, places) for k in range(n)]
    added = np.array([digits_of(x, base, places) for x in moved]) - np.array(numbers)
    assert len(np.unique(added % base, axis=0)) == 1


def digits_of_index(k, base, places):
    """Return the digits of the radical inverse of k, first digit first."""
    return [k // base**p % base for p in range(places)]


def test_permute_has_one_permutation_for_each_place():
    base, places = 5, 4
    n = base**3
    before = np.array([digits_of_index(k, base, places) for k in range(n)])
    points = sampler(f"van-der-corput(base={base})").draw(n)
    after = [digits_of(x, base, places) for x in Permute(base=base).apply(points, STREAM, 0).flat]
    for k in range(3):
        pairs = np.unique(np.stack([before[:, k], np.array(after)[:, k]]), axis=1)
        assert pairs.shape[1] == base
        assert len(np.unique(pairs[1])) == base
    assert len(np.unique(np.array(after)[:, 3])) == 1  # all zeros before scrambling


def test_permute_in_base_2_is_the_digital_shift():
    points = Random(dims=2).draw(16, realizations=5, rng=2)
    np.testing.assert_array_equal(
        Permute().apply(points, STREAM, 3), DigitalShift().apply(points, STREAM, 3)
    )


def test_digital_shift_keeps_the_xor_of_points():
    points = Random(dims=2).draw(16, realizations=5, rng=2)
    before = (points * 2.0**53).astype(np.uint64)
    after = (DigitalShift().apply(points, STREAM, 0) * 2.0**53).astype(np.uint64)
    word = before ^ after
    np.testing.assert_array_equal(word, np.broadcast_to(word[:, :1], word.shape))
    assert len(np.unique(word[:, 0])) == 10


@pytest.mark.parametrize("shift", [True, False])
def test_lms_is_linear_and_triangular_in_base_2(shift):
    """f(a ⊕ b) = f(a) ⊕ f(b) ⊕ f(0), and leading bits depend on leading bits only."""
    a, b = np.random.default_rng(4).integers(0, 2**53, (2, 500))
    words = np.stack([a, b, a ^ b, np.zeros_like(a)])
    moved = Lms(shift=shift).apply(words.reshape(1, -1, 1) * 2.0**-53, STREAM, 0)
    f = (moved.reshape(4, -1) * 2.0**53).astype(np.int64)
    np.testing.assert_array_equal(f[0] ^ f[1] ^ f[2] ^ f[3], 0)
    assert (f[3][0] != 0) == shift
    lengths = [int(x).bit_length() for x in f[0] ^ f[1]]
    np.testing.assert_array_equal(lengths, [int(x).bit_length() for x in a ^ b])


@pytest.mark.parametrize("base", [3, 11])
def test_lms_is_linear_and_triangular_in_other_bases(base):
    places = 8
    rng = np.random.default_rng(5)
    a, b = rng.integers(0, base, (2, 200, places))
    weights = float(base) ** -np.arange(1.0, places + 1)
    digits = np.stack([a, b, (a + b) % base, np.zeros_like(a)])
    moved = Lms(base=base).apply((digits @ weights).reshape(1, -1, 1), STREAM, 0).ravel()
    f = np.array([digits_of(x, base, places) for x in moved]).reshape(4, 200, places)
    np.testing.assert_array_equal((f[0] + f[1] - f[2] - f[3]) % base, 0)
    np.testing.assert_array_equal(np.argmax(f[0] != f[1], 1), np.argmax(a != b, 1))


@pytest.mark.parametrize(("base", "cells"), [(2, 2), (3, 3), (5, 5)])
def test_entries_of_lms_matrices_are_uniform(base, cells):
    """Digit 2 of 1/b is the entry in row 2 and column 1; digit 1 the diagonal, never zero."""
    moved = scrambled(Lms(shift=False, base=base), [1 / base])[:, 0]
    digits = np.floor(np.stack([moved * base % base, moved * base**2 % base])).astype(int)
    assert (digits[0] > 0).all()
    diagonal = np.bincount(digits[0], minlength=base)[1:]
    assert base == 2 or stats.chisquare(diagonal).pvalue > LEVEL
    assert stats.chisquare(np.bincount(digits[1], minlength=cells)).pvalue > LEVEL


def common_digits(a, b, base, places):
    """Return the number of leading digits that two coordinates share, at most `places`."""
    pairs = zip(digits_of(a, base, places), digits_of(b, base, places), strict=True)
    return next((k for k, (x, y) in enumerate(pairs) if x != y), places)


@pytest.mark.parametrize(
    ("step", "base", "places"),
    [(Owen(), 2, 32), (Owen(method="hash"), 2, 32), (Owen(base=3), 3, 20), (Owen(base=10), 10, 9)],
    ids=str,
)
def test_owen_keeps_the_number_of_common_leading_digits(step, base, places):
    rng = np.random.default_rng(3)
    near = (np.floor(rng.random(500) * base**places) + 0.5) / base**places
    depth = rng.integers(1, places + 1, 500).astype(float)
    far = np.abs(near - base**-depth) % 1.0
    moved = step.apply(np.stack([near, far]).reshape(1, -1, 1), STREAM, 0).reshape(2, -1)
    shared = [common_digits(a, b, base, places) for a, b in zip(near, far, strict=True)]
    assert min(shared) == 0
    assert max(shared) >= places - 1
    kept = [common_digits(a, b, base, places) for a, b in zip(*moved, strict=True)]
    np.testing.assert_array_equal(kept, shared)


@pytest.mark.parametrize("base", [3, 7, 96, 97, 2003, 8191])
def test_written_digits_are_read_correctly(base):
    """Digits of any interval, even with a tail near its ends, and ⌊x b^p⌋ in floats."""
    places, scale, nudge, unit = _scramble_kernels._format(base)
    assert 2.0**32 <= scale < 2.0**32 * base
    rng = np.random.default_rng(base)
    starts = rng.integers(0, base, 300) * base ** (places - 1)
    ends = starts + base ** (places - 1) - 1
    for v in np.concatenate([starts, ends, rng.integers(0, int(scale), 300)]).tolist():
        for tail in (0.0, BELOW_ONE):
            x = _scramble_kernels._write(v, tail, scale, unit)
            assert _scramble_kernels._read(x, scale, nudge) == v
            assert np.floor(x * base) == v // base ** (places - 1)
            assert v < Fraction(x) * base**places < v + 1


@pytest.mark.parametrize("method", ["nested", "hash"])
@pytest.mark.parametrize("level", [1, 5, 6, 7, 11, 12, 30, 31])
def test_owen_flips_depend_on_every_higher_bit(level, method):
    """Two prefixes that differ in their last bit have independent flips of the next bit."""
    moved = scrambled(Owen(method=method), [0.0, 2.0**-level])
    flips = np.floor(moved * 2.0 ** (level + 1)).astype(np.int64) % 2
    pairs = np.bincount(flips @ [2, 1], minlength=4)
    assert stats.chisquare(pairs).pvalue > LEVEL


@pytest.mark.parametrize("method", ["nested", "hash"])
def test_owen_tails_are_independent(method):
    """Two points with 32 equal leading bits agree down to 2^-32 and differ below."""
    moved = scrambled(Owen(method=method), [0.3, 0.3])
    np.testing.assert_array_equal(*np.floor(moved * 2.0**32).T)
    tails = np.floor(moved * 2.0**32 % 1.0 * 4).astype(int) @ [4, 1]
    assert stats.chisquare(np.bincount(tails, minlength=16)).pvalue > LEVEL


@pytest.mark.parametrize("level", [0, 1, 7])
def test_permutations_of_two_nodes_are_uniform_and_independent(level):
    """Base 3: all 6 · 6 pairs of permutations of the children of two neighboring nodes."""
    children = [(node + k / 3) / 3**level for node in (0, 1) for k in range(3)]
    if level == 0:
        children = children[:3]
    moved = scrambled(Owen(base=3), children)
    digits = np.floor(moved * 3.0 ** (level + 1) % 3).astype(int)
    codes = digits.reshape(len(moved), -1, 3) @ [9, 3, 1]
    seen, which = np.unique(codes, return_inverse=True)
    assert len(seen) == 6
    joint = which.reshape(codes.shape) @ 6 ** np.arange(codes.shape[1])
    assert stats.chisquare(np.bincount(joint, minlength=6 ** codes.shape[1])).pvalue > LEVEL


@pytest.mark.parametrize("base", [13, 97])
def test_permutations_of_large_bases_are_uniform(base):
    """Images of two digits, in 7 · 7 classes with probabilities counted over all pairs."""
    moved = scrambled(Owen(base=base), [1 / base, (base - 1) / base])
    images = np.floor(moved * base).astype(int)
    assert (images[:, 0] != images[:, 1]).all()
    x, y = np.indices((base, base))
    expected = np.bincount((x % 7 * 7 + y % 7)[x != y], minlength=49) / (base * (base - 1))
    counts = np.bincount(images[:, 0] % 7 * 7 + images[:, 1] % 7, minlength=49)
    possible = expected > 0
    assert not counts[~possible].any()
    assert stats.chisquare(counts[possible], expected[possible] * len(images)).pvalue > LEVEL


def test_binary_coordinates_do_not_depend_on_other_bases():
    points = Random(dims=2).draw(50, realizations=2, rng=1)
    np.testing.assert_array_equal(
        Owen(base=(2, 3)).apply(points, STREAM, 0)[..., 0], Owen().apply(points, STREAM, 0)[..., 0]
    )


@pytest.mark.parametrize(
    ("step", "bits"),
    [
        (Owen(), [0.07470787625435893, 0.30880425709782644]),
        (DigitalShift(), [0.8361977159884867, 0.1792559962757896]),
    ],
    ids=str,
)
def test_bits_of_base_2_do_not_change(step, bits):
    moved = step.apply(np.array([[[0.3, 0.7]]]), Stream(5), 2)
    np.testing.assert_array_equal(moved.ravel(), bits)


NETS = [
    ("sobol", 1, 1),
    ("sobol", 5, 1024),
    ("niederreiter", 3, 2),
    ("larcher-pillichshammer", 2, 64),
]
INVERSES = [
    ("halton", 3, 1),
    ("halton(skip=12345)", 5, 3000),
    ("van-der-corput(base=8192)", 1, 50),
    ("van-der-corput(base=6)", 1, 5000),
    ("halton(scramble='owen')", 2, 100),
]


@pytest.mark.parametrize(
    ("step", "net", "dims", "n"),
    [
        *((s, *net) for s in (Owen(method="hash"), Lms(), Lms(shift=False)) for net in NETS),
        *((s, *inverse) for s in (Permute(), DigitalShift()) for inverse in INVERSES),
    ],
    ids=str,
)
def test_fused_kernels_give_the_same_bits(step, net, dims, n):
    source = sampler(net, dims)
    chained = source.then(step).draw(n, realizations=3, rng=SEED, first=2)
    own = Stream.from_rng(SEED).child((1 << 16) + source.scrambles)
    np.testing.assert_array_equal(
        chained,
        step.fit(source).apply(source.draw(n, realizations=3, rng=SEED, first=2), own, 2),
        strict=True,
    )


@pytest.mark.filterwarnings("ignore::mcspectra.core.errors.NotPowerOfTwoWarning")
def test_fused_kernels_give_the_same_prefixes():
    whole = sampler(f"sobol | {HASH}", 3).draw(1024, rng=1)
    np.testing.assert_array_equal(sampler(f"sobol | {HASH}", 3).draw(777, rng=1), whole[:, :777])


@pytest.mark.parametrize(
    "step", [DigitalShift(), Owen(), Owen(method="hash"), Lms()], ids=lambda step: step.spec
)
@pytest.mark.parametrize("x", [0.0, 0.3, BELOW_ONE])
def test_points_become_uniform_in_base_2(step, x):
    """χ² of the leading 6 bits, bits 31 to 36 across the end of scrambling, and the last 6 bits."""
    moved = scrambled(step, [x]).ravel()
    for scale in (0, 30, 47):
        bits = np.floor(moved * 2.0 ** (scale + 6)).astype(np.int64) % 64
        assert stats.chisquare(np.bincount(bits, minlength=64)).pvalue > LEVEL / 3


@pytest.mark.parametrize("step", [DigitalShift, Permute, Owen, Lms], ids=lambda step: step.name)
@pytest.mark.parametrize("base", [3, 97])
def test_points_become_uniform_in_other_bases(step, base):
    """Leading digits, the digits across the end of scrambling, and the part below 2^-36."""
    moved = scrambled(step(base=base), [0.3]).ravel()
    for scale in (1, 2**33, 2**36):
        cells = np.floor(moved * scale * 32).astype(np.int64) % 32
        assert stats.chisquare(np.bincount(cells, minlength=32)).pvalue > LEVEL / 3


@pytest.mark.parametrize(
    "step",
    [
        *(DigitalShift(), Permute(), Owen(), Owen(method="hash"), Lms(), Lms(shift=False)),
        *(step(base=b) for step in (DigitalShift, Permute, Owen, Lms) for b in (3, 97, 8191)),
    ],
    ids=lambda step: step.spec,
)
def test_results_stay_in_the_cube_at_the_edges(step):
    edges = np.array([0.0, 5e-324, 2.0**-60, 2.0**-33, 1 / 3, 0.5 - 2.0**-54, 0.5, BELOW_ONE])
    realizations = 20 if step.base == 8191 else 2000
    moved = step.apply(np.tile(edges[:, None], (realizations, 1, 1)), STREAM, 0)
    assert moved.min() >= 0.0
    assert moved.max() < 1.0


@pytest.mark.parametrize(
    ("spec", "dims", "n", "expected"),
    [
        ("random | owen", 1, 16, 1 / (12 * 16)),
        ("sobol | digital-shift", 1, 16, 1 / (12 * 16**2)),
        ("sobol | lms", 1, 16, 1 / (12 * 16**3)),
        ("sobol | owen", 1, 16, 1 / (12 * 16**3)),
        (f"sobol | {HASH}", 1, 16, 1 / (12 * 16**3)),
        ("sobol | owen", 3, 16, 1 / (12 * 16**3)),
        (f"sobol | {HASH}", 3, 16, 1 / (12 * 16**3)),
        ("van-der-corput(base=5) | owen", 1, 25, 1 / (12 * 25**3)),
        ("van-der-corput(base=5) | permute", 1, 25, 1 / (12 * 25**2)),
        ("faure | owen", 3, 27, 1 / (12 * 27**3)),
    ],
)
def test_variance_of_the_mean_coordinate(spec, dims, n, expected):
    """Exact: a shared offset within 1/n gives 1/(12 n²), independent strata 1/(12 n³).

    The same holds after matrix scrambling. A digit below 1/n is balanced unless its row has only
    zeros, which happens once in n times; then all points share it.
    """
    means = sampler(spec, dims).draw(n, realizations=10_000, rng=8)[..., -1].mean(axis=1)
    centred = means - means.mean()
    error = np.sqrt((np.mean(centred**4) - means.var() ** 2) / len(means))
    assert abs(means.var(ddof=1) - expected) < SIGMAS * error
    assert abs(means.mean() - 0.5) < SIGMAS * np.sqrt(expected / len(means))


def test_owen_beats_jitter_on_a_smooth_function():
    """exp(−x²−y²), n = 256: below the jittered variance ∫|∇f|²/(12 n²), 1/34 of random points'.

    Owen's variance is of order n^-3 log n; SIGMAS standard errors, sqrt(2/R), are added.
    """
    n, realizations = 256, 500
    points = sampler("sobol | owen", 2).draw(n, realizations=realizations, rng=9)
    square = np.square(points).sum(axis=-1)
    values = np.exp(-square)
    jittered = np.mean(4 * square * values**2) / (12 * n**2)
    measured = values.mean(axis=1).var(ddof=1)
    assert measured * (1 + SIGMAS * np.sqrt(2 / realizations)) < jittered
    assert jittered < 0.1 * values.var() / n


@pytest.mark.parametrize("step", ["digital-shift", "permute", "owen", HASH])
def test_strata_survive_at_powers_of_two(step):
    points = sampler(f"jittered | {step}", 2).draw(64, realizations=50, rng=1)
    cells = np.sort(np.floor(points * 8) @ [8, 1], axis=1)
    np.testing.assert_array_equal(cells, np.broadcast_to(np.arange(64), cells.shape))
    points = sampler(f"latin-hypercube | {step}", 3).draw(32, realizations=50, rng=1)
    rows = np.sort(np.floor(points * 32), axis=1)
    np.testing.assert_array_equal(rows, np.broadcast_to(np.arange(32)[:, None], rows.shape))


def test_strata_survive_at_powers_of_a_given_base():
    points = sampler("jittered | owen(base=3)", 2).draw(81, realizations=50, rng=1)
    cells = np.sort(np.floor(points * 9) @ [9, 1], axis=1)
    np.testing.assert_array_equal(cells, np.broadcast_to(np.arange(81), cells.shape))


@pytest.mark.parametrize(
    ("spec", "dims", "n", "nearest"),
    [
        ("jittered | owen", 2, 9, (4, 16)),
        ("jittered | lms", 2, 9, (4, 16)),
        ("jittered | digital-shift", 2, 36, (16, 64)),
        ("jittered | permute", 3, 2, (1, 8)),
        ("latin-hypercube | owen", 3, 100, (64, 128)),
        ("jittered | owen(base=3)", 2, 64, (9, 81)),
        ("jittered | shift | owen", 1, 7, ()),
        ("antithetic-jittered | digital-shift", 2, 1, (2,)),
        ("jittered | owen | digital-shift", 2, 9, (4, 16)),
        ("jittered | owen", 2, 2**31 - 1, (2**30,)),
    ],
)
def test_other_counts_on_strata_are_refused(spec, dims, n, nearest):
    if not nearest:
        with pytest.raises(ParameterError, match="would break the distances"):
            sampler(spec, dims)
        return
    source = sampler(spec, dims)
    with pytest.raises(CountError, match=r"nearest counts? (is|are)") as caught:
        source.draw(n)
    assert caught.value.nearest == nearest
    assert all(source.check_count(count) == count for count in nearest)


def test_no_count_fits():
    with pytest.raises(
        ParameterError, match=r"sides=\[3, 5\].*counts are never powers of 2; use shift"
    ):
        sampler("regular(sides=[3, 5]) | owen", 2)


def test_the_base_of_the_sampler_is_in_the_spec():
    assert sampler("halton | owen", 3).spec == "halton | owen(base=[2, 3, 5])"
    assert sampler("sobol | owen", 3).spec == "sobol | owen"
    assert sampler("jittered | owen(base=3)", 2).spec == "jittered | owen(base=3)"


def test_declared_properties():
    declared = {
        step.spec: (step.stationary, step.debiases)
        for step in (DigitalShift(), Permute(), Owen(), Lms(), Lms(shift=False))
    }
    assert declared == {
        "digital-shift": (False, True),
        "permute": (False, True),
        "owen": (False, True),
        "lms": (False, True),
        "lms(shift=False)": (False, False),
    }
