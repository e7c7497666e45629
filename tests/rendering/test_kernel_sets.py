"""Sets computed in kernels: the samplers' own points, and sets in random orders."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from mcspectra.core.streams import Stream
from mcspectra.rendering import Wavefront, load_mitsuba, render
from mcspectra.rendering.kernel_sets import (
    NetPoints,
    Pads,
    Rounds,
    _Bits,
    _in_cell,
    _own_digits,
    _unit,
    net_of,
    rule_of,
    scramble_key,
)
from mcspectra.rendering.plugin import (
    PaddedSets,
    PixelState,
    joint_sampler,
    register_samplers,
    seed_lanes,
)
from mcspectra.samplers import as_sampler
from mcspectra.samplers.lattice import golden_steps

pytestmark = pytest.mark.render

LEVEL = 1e-3
SETS = 20_000


def arrays(columns, sets, count):
    return np.stack([c.numpy() for c in columns], axis=-1).reshape(sets, count, -1).astype(float)


@pytest.mark.parametrize(
    ("net", "dims", "count"),
    [
        ("sobol", 1, 1),
        ("sobol", 8, 64),
        ("sobol", 2, 5),
        ("niederreiter", 5, 16),
        ("larcher-pillichshammer", 2, 32),
    ],
)
@pytest.mark.filterwarnings("ignore::mcspectra.core.errors.NotPowerOfTwoWarning")
def test_points_agree_with_hashed_owen_scrambling(net, dims, count):
    mitsuba, sampler = load_mitsuba(), as_sampler(f"{net} | owen(method='hash')", dims)
    import drjit

    streams = [Stream(5), Stream(2**63 + 6)]
    keys = np.array([scramble_key(stream) for stream in streams], np.uint64)
    scrambled = net_of(sampler)
    assert scrambled is not None
    points = NetPoints(scrambled, count, keys, np.arange(3, 10, dtype=np.uint32))
    assert points.shape == (14, count, dims)
    lane = drjit.arange(mitsuba.UInt32, 14 * count)
    found = arrays(points.lanes(mitsuba, lane // count)(lane % count), 14, count)
    drawn = np.concatenate([sampler.draw_stream(count, stream, 3, 7) for stream in streams])
    below = drawn - found
    assert below.min() >= 0.0  # points are rounded down to multiples of 2^-24
    assert below.max() < 2.0**-24


@pytest.mark.parametrize(
    ("spec", "there"),
    [
        ("sobol | owen", True),
        ("sobol | owen(method='hash')", True),
        ("sobol | owen(base=2)", True),
        ("sobol", False),
        ("sobol | owen | shift", False),
        ("sobol | digital-shift", False),
        ("halton | owen", False),
        ("faure | owen", False),
        ("jittered | owen", False),
    ],
)
def test_nets_are_found_where_owen_alone_scrambles_them(spec, there):
    assert (net_of(as_sampler(spec, 2)) is not None) == there


@dataclass(frozen=True)
class _Slow:
    """A net whose second coordinates are below one half."""

    dims = 2

    def direction_numbers(self, n):
        columns = np.zeros((2, 32), np.uint32)
        columns[0, :3] = 2**31, 2**30, 2**29
        columns[1, :3] = 2**30, 2**30 + 2**29, 2**29 + 2**26
        return columns


def test_scrambled_digits_are_those_with_which_points_differ():
    for spec, dims in (("sobol", 12), ("larcher-pillichshammer", 2)):
        for n in (1, 2, 5, 16, 1024) if spec == "sobol" else (2, 16, 1024):
            assert _own_digits(as_sampler(spec, dims), n) == (n - 1).bit_length()
    # Columns 010, 011 and 001001: three digits tell four points apart, and six digits eight
    assert _own_digits(_Slow(), 4) == 3
    assert _own_digits(_Slow(), 8) == 6
    numbers = np.zeros(1, int)
    for column in _Slow().direction_numbers(8)[1, :3].astype(int):
        numbers = np.concatenate([numbers, numbers ^ column])
    assert [len(set(numbers >> (32 - k))) for k in (5, 6)] == [4, 8]


@pytest.mark.parametrize("film", ["center", "sampled"])
def test_images_have_the_samplers_points_in_each_pixel(film):
    scene, spec, width = "veach(width=12, height=8)", "sobol | owen(method='hash')", 12
    waves = Wavefront(scene, film=film, emission=True)
    sampler = as_sampler(spec, waves.dims("mis"))
    x, y = np.meshgrid(np.arange(3, 8), np.arange(2, 6))
    pixels = np.stack([x.ravel(), y.ravel()], axis=-1)
    images = []
    for image in range(3):
        stream = Stream.from_rng(7).child(image)
        u = [sampler.draw_stream(16, stream, int(px + width * py), 1)[0] for px, py in pixels]
        images.append(waves.means("mis", pixels, np.stack(u)).reshape(4, 5, 3))
    found = render(scene, "mis", spec, 16, crop=(3, 2, 5, 4), film=film, realizations=3, rng=7)
    # Points differ by 2^-24, so that a ray near an edge may miss it.
    close = np.isclose(found["image"], np.mean(images, axis=0), rtol=1e-4)
    assert close.mean() > 0.95
    assert np.isclose(found["variance"], np.var(images, axis=0, ddof=1), rtol=1e-3).mean() > 0.9
    nested = render(scene, "mis", "sobol | owen", 16, crop=(3, 2, 5, 4), film=film, rng=7)
    hashed = render(scene, "mis", spec, 16, crop=(3, 2, 5, 4), film=film, rng=7)
    assert np.array_equal(nested["image"], hashed["image"])


def kernel_sets(spec, n, sets, *requests):
    """Sets that kernels compute for the requests (dims, number) of pixels: (sets, n, dims) each."""
    mitsuba = load_mitsuba()
    import drjit

    rules = tuple(rule_of(as_sampler(spec, dims), n) for dims in (1, 2))
    assert None not in rules
    lane = drjit.arange(mitsuba.UInt32, n * sets)
    pixel, index = lane // n, lane % n
    source = Pads(mitsuba, rules, n, Stream(9)).at(pixel, index)

    def drawn(dims, request):
        address = drjit.full(mitsuba.UInt32, 0, n * sets)
        for _ in range(request):
            address = source.following(address)
        return arrays(source.draw(dims, pixel, address, index), sets, n)

    return [drawn(*request) for request in requests]


@pytest.fixture(scope="module")
def pads():
    """Sets of 16 points for requests of 20,000 pixels: two pairs and a single number."""
    made = kernel_sets("sobol | owen", 16, SETS, (2, 0), (2, 1), (1, 0))
    return dict(zip(("first", "second", "single"), made, strict=True))


def test_pads_are_balanced_in_every_elementary_interval(pads):
    for name in ("first", "second"):
        for columns in (1, 2, 4, 8, 16):
            cells = np.floor(pads[name] * [columns, 16 // columns]) @ [16 // columns, 1]
            assert (np.sort(cells, axis=1) == np.arange(16)).all()
    assert (np.sort(np.floor(pads["single"][..., 0] * 16), axis=1) == np.arange(16)).all()


def test_every_point_of_a_pad_is_uniform(pads):
    points = np.concatenate(list(pads.values()), axis=-1).reshape(SETS, -1)
    assert points.max() < 1.0
    p = min(stats.kstest(column, "uniform").pvalue for column in points.T)
    assert -np.expm1(points.shape[1] * np.log1p(-p)) > LEVEL


def test_pairs_of_a_scrambled_set_are_independent_below_their_first_different_digit(
    pads,
):
    # Points in one half of the interval: their next two digits are those of all pairs that differ
    # there, and the digits after the fourth are independent and uniform.
    x = np.sort(pads["first"][..., 0], axis=1)
    digits = np.floor(x * 256).astype(int) % 16  # base-2 digits 5 to 8 of all 16 points
    for i, j in ((0, 1), (0, 8), (3, 12), (6, 7)):
        table = np.bincount(digits[:, i] * 16 + digits[:, j], minlength=256)
        assert stats.chisquare(table).pvalue > LEVEL / 4


@pytest.mark.parametrize(
    ("one", "other"), [("first", "second"), ("first", "single"), ("second", "single")]
)
def test_orders_of_requests_are_independent(pads, one, other):
    # Overlap of 8 of 16 in one half with 8 of 16 in the other: hypergeometric, mean 4.
    halves = (pads[name][..., 0] < 0.5 for name in (one, other))
    together = np.logical_and(*halves).sum(axis=1)
    mass = stats.hypergeom(16, 8, 8).pmf(np.arange(1, 8))
    found = np.bincount(together, minlength=9)[1:8]
    assert stats.chisquare(found, found.sum() * mass / mass.sum()).pvalue > LEVEL


def test_requests_and_neighbors_share_no_set(pads):
    numbers = np.concatenate([pads["first"][..., 0].ravel(), pads["second"][..., 0].ravel()])
    expected = numbers.size**2 / 2.0**25  # equal pairs of independent 24-bit numbers
    _, times = np.unique(numbers, return_counts=True)
    equal = (times * (times - 1) / 2).sum()
    assert abs(equal - expected) < 5.0 * expected**0.5


SHIFTED = "larcher-pillichshammer | digital-shift(jitter=True)"


@pytest.mark.parametrize("n", [16, 64])
def test_shifted_pads_are_the_nets_of_the_sampler(n):
    """Pads of a kernel are balanced, uniform, and have the variance of the sampler's own points."""
    register_samplers()
    mitsuba, sets = load_mitsuba(), 2000
    made = mitsuba.load_dict({"type": "mcspectra", "spec": SHIFTED, "sample_count": n})
    made.set_samples_per_wavefront(n)
    made.seed(mitsuba.UInt32(3), n * sets)
    pairs = (made.next_2d() for _ in range(2))
    first, second = (arrays((pair.x, pair.y), sets, n) for pair in pairs)
    own = as_sampler(SHIFTED, 2).draw(n, realizations=sets, rng=1)
    m = n.bit_length() - 1
    for points in (first, second, own):
        for k in range(m + 1):
            cells = np.floor(points * [2**k, 2 ** (m - k)]) @ [2 ** (m - k), 1]
            assert (np.sort(cells, axis=-1) == np.arange(n)).all()
        # Every point of a set is uniform: the first point over 16 cells, at the level 1e-6
        counts = np.bincount((points[:, 0] * 4).astype(int) @ [4, 1], minlength=16)
        assert stats.chisquare(counts).pvalue > 1e-6
    assert abs(np.corrcoef(first[:, 0, 0], second[:, 0, 0])[0, 1]) < 5 / np.sqrt(sets)

    def variance(points):
        return np.exp(-((points - [0.37, 0.61]) ** 2).sum(-1) / 0.05).mean(axis=1).var(ddof=1)

    # Each variance has a relative error of about sqrt(2 / sets) = 3 %
    known = variance(own)
    assert variance(first) == pytest.approx(known, rel=0.25)
    assert variance(second) == pytest.approx(known, rel=0.25)
    # Points that keep their distances integrate a bump better than a scrambled net
    assert known < 0.6 * variance(as_sampler("sobol | owen", 2).draw(n, realizations=sets, rng=1))


def test_shifted_joint_sets_have_the_variance_of_their_sampler():
    register_samplers()
    mitsuba, sets, n = load_mitsuba(), 2000, 16
    made = mitsuba.load_dict({"type": "mcspectra", "spec": SHIFTED, "sample_count": n})
    made.set_samples_per_wavefront(n)
    made.seed(mitsuba.UInt32(3), n * sets)
    pairs = [made.next_2d() for _ in range(2)]
    drawn = arrays([c for pair in pairs for c in (pair.x, pair.y)], sets, n)
    own = joint_sampler(as_sampler(SHIFTED, 2), 4).draw(n, realizations=sets, rng=1)
    # Both have the same points per cell of sides ½, in some order of the cells
    for points in (drawn, own):
        cells = np.floor(points * 2) @ [8, 4, 2, 1]
        assert (np.sort(cells, axis=-1) == np.arange(16)).all()

    def variance(points):
        return np.exp(-((points - [0.37, 0.61, 0.2, 0.7]) ** 2).sum(-1)).mean(axis=1).var(ddof=1)

    # Each variance has a relative error of about sqrt(2 / sets) = 3 %
    assert variance(drawn) == pytest.approx(variance(own), rel=0.2)


MASK = "sobol | decorrelate(mask='blue-noise')"
WHITE = "sobol | owen | decorrelate(mode='digital-shift')"
KERNELS = [
    ("random", 7),
    ("jittered", 9),
    ("jittered", 16),
    ("sobol | owen", 12),
    ("sobol | digital-shift(jitter=True)", 12),
    ("rank1-lattice | shift", 13),
    ("uniform-jitter", 9),
    ("sobol | owen | decorrelate(mode='shift')", 8),
    ("sobol | decorrelate(mode='owen')", 8),
    (WHITE, 12),
    (MASK, 8),
]
"""Samplers that kernels compute, with counts that are powers of two and others."""


@pytest.mark.filterwarnings("ignore::mcspectra.core.errors.NotPowerOfTwoWarning")
@pytest.mark.parametrize(("spec", "n"), KERNELS)
def test_points_of_kernels_are_uniform_and_requests_independent(spec, n):
    """Every point is uniform, points of two requests or pixels are uncorrelated."""
    sets = 4096
    first, second, single = kernel_sets(spec, n, sets, (2, 0), (2, 1), (1, 0))
    drawn = np.concatenate([first, second, single], axis=-1)
    assert drawn.min() >= 0.0
    assert drawn.max() < 1.0
    columns = drawn.reshape(sets, -1).T
    p = min(stats.kstest(column, "uniform").pvalue for column in columns)
    assert -np.expm1(len(columns) * np.log1p(-p)) > LEVEL
    # Points i of two requests, or of neighboring pixels. The coordinates of a set have the variance
    # 1/12. Sums of n products in a random order have the variance n/144, or n²/(n − 1)/144
    # if the means of the sets do not vary
    most = 5.0 * n * (sets / max(1, n - 1)) ** 0.5
    z = drawn - 0.5
    requests = [[0, 1], [2, 3], [4]]
    for a in range(3):
        for b in range(a):
            found = 12.0 * np.einsum("rij,rik->jk", z[..., requests[a]], z[..., requests[b]])
            assert np.abs(found).max() < most
    if spec != MASK:  # a mask makes neighbors different on purpose
        found = 12.0 * np.einsum("rij,rij->j", z[1:], z[:-1])
        assert np.abs(found).max() < most


@pytest.mark.parametrize("n", [1, 9, 16, 25])
def test_jittered_sets_have_one_point_in_each_cell(n):
    side = round(n**0.5)
    pair, single = kernel_sets("jittered", n, 2000, (2, 0), (1, 0))
    cells = np.floor(pair * side) @ [side, 1]
    assert (np.sort(cells, axis=1) == np.arange(n)).all()
    assert (np.sort(np.floor(single[..., 0] * n), axis=1) == np.arange(n)).all()
    # Points are uniform within their cells, and orders are uniform: the first point in each cell
    shares = (pair * side) % 1.0
    assert stats.kstest(shares.ravel()[:2000], "uniform").pvalue > LEVEL
    if n > 1:
        assert stats.chisquare(np.bincount(cells[:, 0].astype(int), minlength=n)).pvalue > LEVEL


def shifts_of(spec, sets, *requests):
    """Shifts (sets, dims) of a set of one point, and the mask with its stream, for each request."""
    made = []
    for (dims, _), found in zip(requests, kernel_sets(spec, 1, sets, *requests), strict=True):
        rule = rule_of(as_sampler(spec, dims), 1)
        stream = Stream(9).child(dims).child(0)
        base = rule.shared(stream) if callable(rule.shared) else rule.shared.draw(1)
        whole, base = (np.floor(x * 2.0**24).astype(np.int64) for x in (found[:, 0], base[0]))
        shifts = whole ^ base if rule.move == "digital-shift" else (whole - base) % 2**24
        made.append((shifts / 2.0**24, rule.mask, stream.child(rule.mask_label)))
    return made


@pytest.mark.parametrize(
    "spec",
    [
        MASK,
        "sobol | decorrelate(mode='digital-shift', mask='blue-noise', width=16)",
        "sobol | decorrelate(mask='blue-noise', width=12)",
        "sobol | decorrelate(mask='blue-noise', width=16, time='move')",
        "rank1-lattice | decorrelate(mask='spatiotemporal', width=8, frames=4)",
    ],
)
def test_requests_have_the_masks_of_the_sampler_at_other_places(spec):
    sets = 4608
    places = set()
    for shifts, step, stream in shifts_of(spec, sets, (2, 0), (2, 3), (1, 1)):
        masks, width = step.ranks(stream, shifts.shape[1]), step.width
        frames = masks.shape[1]
        ranks = np.floor(shifts * masks[0].size).astype(int)
        place = np.argwhere(masks[0] == ranks[0, 0])[0]  # all ranks of a mask are different
        places.add(tuple(place))
        pixel = np.arange(sets)
        frame, row, column = np.unravel_index(pixel, (sets // width**2 + 1, width, width))
        if step.time == "move":
            steps = np.floor(frame * (golden_steps(2) * 2.0**-64)[:, None] % 1.0 * width)
            column, row = column + steps[0].astype(int), row + steps[1].astype(int)
        at = [
            (k + p) % m for k, p, m in zip((frame, row, column), place, masks[0].shape, strict=True)
        ]
        for rank, mask in zip(ranks.T, masks, strict=True):
            np.testing.assert_array_equal(rank, mask[*at])
        assert frames == (4 if step.mask == "spatiotemporal" else 1)
    assert len(places) == 3


def test_shifts_of_the_golden_ratio_are_added():
    """Shifts of an R-sequence by pixels, and of a mask by frames, to all ranks of a frame."""
    sets = 512
    first, second = shifts_of("sobol | decorrelate(mask='r2')", sets, (2, 0), (2, 1))
    known = np.arange(sets)[:, None] * (golden_steps(2) * 2.0**-64)
    for shifts, _, _ in (first, second):
        apart = (shifts - shifts[0] - known + 0.5) % 1.0 - 0.5
        assert np.abs(apart).max() < 2.0**-22
    assert np.abs(first[0][0] - second[0][0]).max() > 0.01
    spec = "sobol | decorrelate(mask='blue-noise', width=16, time='golden')"
    ((shifts, _, _),) = shifts_of(spec, sets, (2, 0))
    shifts = (shifts - np.repeat([[0.0], [1.0]], 256, axis=0) * known[1]) % 1.0
    ranks = np.floor(shifts * 256)
    # The rounding to 2^-24 may move a shift below the lower end of its interval
    assert (ranks[:256] == ranks[256:]).mean() > 0.99


@pytest.mark.parametrize("way", ["kernel", "table", "scalar"])
def test_shifts_of_two_requests_by_a_mask_are_independent(way):
    """Means of products of two requests are not biased, also if images consist of whole masks."""
    register_samplers()
    spec, sets = "sobol | decorrelate(mask='blue-noise', width=64)", 4096
    if way == "kernel":
        first, second = (values for values, _, _ in shifts_of(spec, sets, (2, 0), (2, 1)))
    elif way == "table":
        points = PaddedSets(spec=f"{spec} | shuffle", count=1)
        assert points.rules is None
        state = seed_lanes(load_mitsuba(), points, Stream(5), sets, 1)
        first, second = (arrays(state.pair(True), sets, 1)[:, 0] for _ in range(2))
    else:
        points = PaddedSets(spec=spec, count=1)
        states = [PixelState(points, Stream(5).child(k)) for k in range(sets)]
        first, second = (np.array([state.pair(True) for state in states]) for _ in range(2))
    for a in range(2):
        for b in range(2):
            mean = np.exp(2j * np.pi * (first[:, a] - second[:, b])).mean()
            assert abs(mean) < 5.0 / sets**0.5


@pytest.mark.parametrize("mode", ["shift", "digital-shift"])
def test_displaced_sets_are_one_set_moved_by_a_vector(mode):
    spec, n = f"sobol | owen | decorrelate(mode='{mode}')", 16
    pair, other = kernel_sets(spec, n, 200, (2, 0), (2, 1))
    whole = (np.concatenate([pair, other]) * 2.0**24).astype(np.int64)
    base = {tuple(point) for point in whole[0]}
    vectors = set()
    for points in whole:
        # Some point of the set goes to the first point of the base
        target = next(iter(base))
        if mode == "shift":
            moved = [(points + (target - p)) % 2**24 for p in points]
        else:
            moved = [points ^ (np.array(target) ^ p) for p in points]
        equal = [k for k, m in enumerate(moved) if {tuple(point) for point in m} == base]
        assert len(equal) == 1
        vectors.add(tuple(points[equal[0]]))
    assert len(vectors) == 400


@pytest.mark.filterwarnings("ignore::mcspectra.core.errors.NotPowerOfTwoWarning")
@pytest.mark.parametrize(("spec", "n"), [k for k in KERNELS if k[0] != "random"])
def test_variances_agree_with_the_points_of_the_host(spec, n):
    """Variances of one pair, and of two pairs together, agree within their errors."""
    sets = 4000
    host, rounds = PaddedSets(spec=spec, count=n), Rounds.of(sets, 4, 2)
    first, second = kernel_sets(spec, n, sets, (2, 0), (2, 1))
    table = host.pads(2, Stream(9 if "decorrelate" in spec else 8), 0, rounds.size)
    numbers = [(np.arange(sets) + k * rounds.stride) % rounds.size for k in (0, 1)]

    def bump(x):
        return np.exp(-((x - [0.37, 0.61]) ** 2).sum(-1) / 0.1)

    def errors(values):
        estimates = values.mean(axis=1)
        deviations = (estimates - estimates.mean()) ** 2
        return deviations.mean(), deviations.std() / sets**0.5

    for values in (lambda a, _: bump(a), lambda a, b: bump(a) * bump(b)):
        ours = errors(values(first, second))
        known = errors(values(*(table[k].astype(float) for k in numbers)))
        assert abs(ours[0] - known[0]) < 4.5 * np.hypot(ours[1], known[1])


def test_words_of_random_bits_are_independent_along_the_requests_of_a_set():
    mitsuba, count = load_mitsuba(), 2**20
    import drjit

    address = drjit.arange(mitsuba.UInt32, count) * Pads.following(None, 0)
    keys = (mitsuba.UInt32(0x12345678), mitsuba.UInt32(0x9ABCDEF0))
    bits = _Bits(mitsuba, keys, address)
    words = [bits.take(32).numpy() for _ in range(3)]
    bytes_of = [(word >> (8 * k)) & 255 for word in words for k in range(4)]
    pairs = [(a, b) for k, a in enumerate(bytes_of) for b in bytes_of[:k]]
    pairs += [(each[:-lag], each[lag:]) for each in bytes_of for lag in (1, 2, 7)]
    p = [stats.chisquare(np.bincount(a * 256 + b, minlength=65536)).pvalue for a, b in pairs]
    assert -np.expm1(len(p) * np.log1p(-min(p))) > LEVEL


def test_pieces_of_random_bits_do_not_overlap():
    mitsuba = load_mitsuba()
    bits = _Bits(mitsuba, (mitsuba.UInt32(1), mitsuba.UInt32(2)), mitsuba.UInt32(3))
    sizes = (24, 23, 9, 32, 8, 1, 0, 20)
    pieces = [int(bits.take(size)[0]) for size in sizes]
    again = _Bits(mitsuba, (mitsuba.UInt32(1), mitsuba.UInt32(2)), mitsuba.UInt32(3))
    a, b, c, d = (int(again.take(32)[0]) for _ in range(4))
    low = 2**24 - 1
    assert pieces == [a & low, b & low >> 1, b >> 23, c, a >> 24, d & 1, 0, (d >> 1) & 2**20 - 1]


def test_samplers_without_a_rule_use_tables():
    for spec in (
        "latin-hypercube",
        "sobol | owen | decorrelate(advance=True)",
        "halton | owen",
        "jittered | mirror",
        "sobol | decorrelate | shuffle",
    ):
        assert rule_of(as_sampler(spec, 2), 16) is None, spec


@pytest.mark.parametrize("cells", [1, 2, 3, 7, 256, 1000, 65535])
@pytest.mark.parametrize("bits", [0, 2**32 - 1])
def test_the_ends_of_cells_are_inside_after_rounding(cells, bits):
    """The smallest and the largest random numbers give points of the cell."""
    mitsuba = load_mitsuba()
    own = SimpleNamespace(take=lambda count: mitsuba.UInt32(bits & (2**count - 1)))
    cell = np.arange(cells)
    corners = mitsuba.UInt32((((cell << 32) + cells - 1) // cells).astype(np.uint32))
    found = _unit(mitsuba, _in_cell(mitsuba, corners, cells, own)).numpy().astype(float)
    if found.size == 1:  # with a single cell, the number does not depend on the corner
        found = np.repeat(found, cells)
    np.testing.assert_array_equal(np.floor(found * cells), cell)
    # The cells leave no gaps of more than two steps of the rounding
    ends = (cell + (bits > 0)) / cells
    assert np.abs(found - ends).max() <= 2.0**-23
