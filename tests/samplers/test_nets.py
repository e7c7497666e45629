"""Digital nets against SciPy, slow references and theory; matrices; the quality parameter t."""

import os
from itertools import product
from math import comb
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import qmc

from mcspectra.core.errors import (
    CountError,
    DomainError,
    FileFormatError,
    NotPowerOfTwoWarning,
    ParameterError,
)
from mcspectra.quality.nets import elementary_intervals, net_t_value
from mcspectra.samplers import (
    DigitalNet,
    Faure,
    LarcherPillichshammer,
    Niederreiter,
    Owen,
    Random,
    Sobol,
    sampler,
)
from mcspectra.samplers.nets import _irreducible, _sobol_directions


def slow_net(matrices, base, n):
    """Return points from matrices (d, rows, columns), one digit at a time, in exact integers."""
    points = []
    for i in range(n):
        index = [i // base**k % base for k in range(len(matrices[0][0]))]
        digits = [[np.dot(row, index) % base for row in matrix] for matrix in matrices]
        points.append(
            [sum(int(y) * base ** (len(d) - 1 - r) for r, y in enumerate(d)) for d in digits]
        )
    return np.array(points) / float(base ** len(matrices[0]))


def slow_t(points, base):
    """Return the quality t by its definition."""
    n, dims = points.shape
    m = round(np.log(n) / np.log(base))
    for t in range(m + 1):
        shapes = [k for k in product(range(m - t + 1), repeat=dims) if sum(k) == m - t]
        sides = np.array([[base**part for part in k] for k in shapes])
        boxes = [np.unique(np.floor(points * side), axis=0, return_counts=True) for side in sides]
        if all(len(b) == base ** (m - t) and (c == base**t).all() for b, c in boxes):
            return t
    raise AssertionError


def random_matrices(base, dims, size, seed):
    return np.random.default_rng(seed).integers(0, base, (dims, size, size))


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize(("base", "dims", "size"), [(2, 2, 5), (2, 4, 4), (3, 3, 3), (5, 2, 2)])
def test_points_and_quality_of_random_matrices(base, dims, size, seed):
    """Random matrices give all values of t; points by a slow sum, t by definition and by counts."""
    matrices = random_matrices(base, dims, size, seed)
    points = DigitalNet(matrices=matrices, base=base).draw(base**size)[0]
    np.testing.assert_array_equal(points, slow_net(matrices, base, base**size))
    # Multiples of 1/b^m may be rounded down as floats, so test the middles of intervals
    t = slow_t(points + 0.5 / base**size, base)
    assert net_t_value(points, base) == t
    assert [elementary_intervals(points, base, q) for q in range(size + 1)] == [
        q >= t for q in range(size + 1)
    ]


def test_quality_of_other_sets():
    assert net_t_value(np.array([[0.3, 0.9]])) == 0
    assert net_t_value(np.array([[0.1, 0.1], [0.2, 0.2]])) == 1
    assert net_t_value(Random(dims=2).draw(12, rng=1)[0]) is None
    assert net_t_value(np.full((64, 2), 0.3)) == 6
    grid = sampler("regular", 2).draw(64)[0]
    assert net_t_value(grid) == 3  # 8 points per column of width 1/8


@pytest.mark.parametrize("dims", [1, 2, 3, 4, 5, 7])
def test_faure_sequences_have_quality_0(dims):
    faure = Faure(dims=dims)
    base = faure.digit_bases[0]
    for m in range(1, 5):
        assert net_t_value(faure.draw(base**m)[0], base) == 0


@pytest.mark.parametrize(("dims", "base"), [(3, 7), (2, 31), (6, 7)])
def test_faure_in_a_given_base(dims, base):
    assert net_t_value(Faure(dims=dims, base=base).draw(base**2)[0], base) == 0


@pytest.mark.parametrize(("dims", "base", "digits"), [(3, 3, 4), (4, 5, 3)])
def test_faure_by_hand(dims, base, digits):
    pascal = [
        [
            [comb(c, r) * j ** (c - r) % base if c >= r else 0 for c in range(digits)]
            for r in range(digits)
        ]
        for j in range(dims)
    ]
    np.testing.assert_array_equal(Faure(dims=dims).generator_matrices(digits), pascal)
    n = base**digits
    np.testing.assert_allclose(
        Faure(dims=dims).draw(n)[0], slow_net(pascal, base, n), rtol=0, atol=2.0**-53
    )


@pytest.mark.filterwarnings("ignore::mcspectra.core.errors.NotPowerOfTwoWarning")
def test_faure_is_a_sequence():
    """Smaller sets are exact prefixes of larger ones, for any number of stored digits."""
    many = Faure(dims=10).draw(11**3 + 5)[0]
    for n in (1, 2, 11, 12, 121, 1000):
        np.testing.assert_array_equal(Faure(dims=10).draw(n)[0], many[:n])
    assert len(np.unique(many, axis=0)) == len(many)


def test_faure_in_many_dims():
    points = Faure(dims=1000).draw(1009)[0]
    strata = np.sort(np.floor(points * 1009 + 1e-6), axis=0)
    np.testing.assert_array_equal(strata, np.broadcast_to(np.arange(1009)[:, None], strata.shape))


def test_faure_warns_of_unbalanced_counts():
    with pytest.warns(NotPowerOfTwoWarning, match="10 faure points are not balanced; 9 and 27"):
        Faure(dims=3).draw(10)


def test_matrices_as_rows_and_as_columns_agree():
    rows = [[[1, 0, 0], [0, 1, 0], [0, 0, 1]], [[1, 1, 1], [0, 1, 0], [0, 0, 1]]]
    columns = [[4, 2, 1], [4, 6, 5]]
    by_rows, by_columns = DigitalNet(matrices=rows), DigitalNet(matrices=columns)
    np.testing.assert_array_equal(by_rows.draw(8), by_columns.draw(8))
    np.testing.assert_array_equal(by_columns.generator_matrices(), rows)
    assert by_columns.dims == 2
    more = DigitalNet(matrices=[[16, 8, 4], [16, 24, 20]], digits=5)
    np.testing.assert_array_equal(more.draw(8), by_rows.draw(8))


def test_sobol_by_its_matrices():
    columns = (Sobol(dims=3).direction_numbers(1)[:, :10] >> np.uint32(22)).tolist()
    np.testing.assert_array_equal(DigitalNet(matrices=columns).draw(1024), Sobol(dims=3).draw(1024))
    assert net_t_value(DigitalNet(matrices=columns).draw(1024)[0]) == 1


def test_fewer_dims_and_points_than_there_are():
    columns = [[4, 2, 1], [4, 6, 5], [1, 2, 4]]
    net, whole = sampler(f"digital-net(matrices={columns})", 2), DigitalNet(matrices=columns)
    np.testing.assert_array_equal(net.draw(4)[0], whole.draw(8)[0, :4, :2])
    assert whole.max_count == 8
    with pytest.raises(CountError, match="makes at most 8 points, not 9"):
        whole.draw(9)
    with pytest.warns(NotPowerOfTwoWarning, match="5 digital-net points are not balanced"):
        whole.draw(5)


def test_files_of_matrices(tmp_path):
    path = tmp_path / "net.txt"
    path.write_text(
        "# dnet\n3  # base\n2  # dims\n9  # points\n3  # digits\n# columns\n9 3\n9 12\n", "utf-8"
    )
    net = sampler(f"digital-net(matrices={path.as_posix()!r}) | owen")
    assert net.digit_bases == (3, 3)
    assert all(elementary_intervals(set_, 3) for set_ in net.draw(9, realizations=20, rng=1))
    assert sampler(net.spec) == net


@pytest.mark.parametrize(
    "text",
    [
        "",
        "2\n2\n4\n",
        "2\n2\n4\n2\n2 1\n",
        "2\n1\n4\n2\n2 x\n",
        "2\n1\n4\n2\n2 4\n",
        "1\n1\n1\n1\n0",
    ],
)
def test_bad_files(tmp_path, text):
    path = tmp_path / "net.txt"
    path.write_text(text, "utf-8")
    with pytest.raises(FileFormatError, match="is not a file of generator matrices"):
        DigitalNet(matrices=str(path))


def test_missing_and_binary_files(tmp_path):
    with pytest.raises(FileFormatError, match="There is no file"):
        DigitalNet(matrices=str(tmp_path / "none.txt"))
    (tmp_path / "net.bin").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(FileFormatError, match="cannot be read"):
        DigitalNet(matrices=str(tmp_path / "net.bin"))


@pytest.mark.parametrize("points", [[[0.5, 1.0]], [[float("nan"), 0.5]], [], [["x", "y"]]])
def test_quality_of_bad_points_is_an_error(points):
    with pytest.raises(DomainError):
        net_t_value(points)


def test_quality_of_wrong_shapes_and_bases():
    with pytest.raises(ParameterError, match="give one set"):
        net_t_value(np.zeros((2, 4, 2)))
    with pytest.raises(ParameterError, match="base is 1"):
        net_t_value(np.zeros((4, 2)), 1)
    with pytest.raises(CountError, match="is not a power of the base 2"):
        elementary_intervals(np.zeros((12, 2)))
    with pytest.raises(ParameterError, match="t is 3"):
        elementary_intervals(np.zeros((4, 2)), t=3)


def test_quality_that_would_take_hours_is_refused_at_once():
    with pytest.raises(ParameterError, match="shapes of elementary intervals"):
        elementary_intervals(np.zeros((2**12, 100)))


def bit_reversed(n):
    bits = n.bit_length() - 1
    return np.array([int(f"{i:0{bits}b}"[::-1], 2) for i in range(n)])


@pytest.mark.parametrize("dims", [1, 2, 10, 37, 1111])
@pytest.mark.parametrize("bits", [0, 1, 5, 10])
def test_points_equal_scipys_in_gray_code_order(dims, bits):
    i = np.arange(2**bits)
    theirs = qmc.Sobol(d=dims, scramble=False, bits=32).random_base2(bits)
    np.testing.assert_array_equal(Sobol(dims=dims).draw(2**bits)[0, i ^ (i >> 1)], theirs)


def test_order_is_natural():
    np.testing.assert_array_equal(Sobol(dims=1).draw(64)[0, :, 0] * 64, bit_reversed(64))
    np.testing.assert_array_equal(Sobol(dims=7).draw(512)[0, :32], Sobol(dims=7).draw(32)[0])


@pytest.mark.parametrize("spec", ["sobol", "sobol | digital-shift", "sobol | owen"])
def test_every_axis_of_every_dim_is_stratified(spec):
    n = 256
    strata = np.sort(np.floor(sampler(spec, 1111).draw(n, rng=3)[0] * n), axis=0)
    np.testing.assert_array_equal(strata, np.broadcast_to(np.arange(n)[:, None], strata.shape))


def test_dims_do_not_repeat():
    points = Sobol(dims=1111).draw(8192)[0]
    assert len({column.tobytes() for column in points.T[:, 4096:]}) == 1111


def test_direction_numbers_are_odd_multiples_of_their_place():
    """v_i = m_i 2^(32−i) with m_i odd and below 2^i; this stratifies every axis."""
    v = _sobol_directions().astype(np.int64)
    place = np.int64(1) << np.arange(31, -1, -1)
    assert v.shape == (1111, 32)
    assert (v % place == 0).all()
    assert (v // place % 2 == 1).all()
    assert (v < 2**32).all()


@pytest.mark.parametrize("n", [3, 6, 100])
def test_other_counts_are_made_with_a_warning(n):
    with pytest.warns(NotPowerOfTwoWarning, match=f"{n} Sobol' points are not balanced"):
        points = Sobol(dims=3).draw(n)
    np.testing.assert_array_equal(points[0], Sobol(dims=3).draw(128)[0, :n])
    with pytest.warns(NotPowerOfTwoWarning):
        sampler("sobol | owen", 3).draw(n)


def test_warning_names_the_balanced_counts_and_the_caller():
    with pytest.warns(NotPowerOfTwoWarning, match="64 and 128 would be") as caught:
        Sobol(dims=2).draw(100)
    assert caught[0].filename == __file__


def test_dims_end_with_the_table():
    with pytest.raises(ParameterError, match="from 1 to 1111"):
        Sobol(dims=1112)


def multiplied(a, b):
    """Return the product of polynomials over two elements, from lists of coefficients."""
    product = np.convolve(*([int(c) for c in f"{p:b}"] for p in (a, b))) % 2
    return int("".join(map(str, product)), 2)


def test_irreducible_polynomials():
    """No product is among them, and their number for each degree follows Gauss's formula."""
    polynomials = _irreducible()
    assert polynomials[:9] == (
        0b10,
        0b11,
        0b111,
        0b1011,
        0b1101,
        0b10011,
        0b11001,
        0b11111,
        0b100101,
    )
    products = {multiplied(a, b) for a in range(2, 64) for b in range(2, 64)}
    assert not products.intersection(polynomials)
    degrees = np.bincount([p.bit_length() - 1 for p in polynomials])
    np.testing.assert_array_equal(degrees[1:], [2, 1, 2, 3, 6, 9, 18, 30, 56, 99, 186, 335, 630])


@pytest.mark.parametrize("dims", [2, 5, 20])
def test_niederreiter_matrices_are_laurent_series(dims):
    """Row q e + u times p^(q+1) is x^u: all coefficients of negative powers vanish."""
    columns = Niederreiter(dims=dims).direction_numbers(1)[-1].astype(np.int64)
    p = _irreducible()[dims - 1]
    degree = p.bit_length() - 1
    for row in range(12):
        series = [int(columns[k] >> (31 - row)) & 1 for k in range(32)]  # at x^-1, x^-2, …
        q, u = divmod(row, degree)
        power = 1
        for _ in range(q + 1):
            power = multiplied(power, p)
        top = power.bit_length() - 1
        product = np.convolve([int(c) for c in f"{power:b}"], series) % 2  # from x^(top − 1) down
        expected = np.zeros(32, int)
        expected[top - 1 - u] = 1
        np.testing.assert_array_equal(product[:32], expected)


@pytest.mark.parametrize(
    ("dims", "t", "reached"), [(1, 0, 3), (2, 0, 3), (3, 1, 1), (4, 3, 6), (5, 5, 9)]
)
def test_quality_of_niederreiter_is_the_sum_of_degrees_less_one(dims, t, reached):
    found = [net_t_value(Niederreiter(dims=dims).draw(2**m)[0]) for m in range(1, 12)]
    assert max(found) == t == found[reached - 1]


def test_niederreiter_repeats_no_dim():
    points = Niederreiter(dims=1377).draw(4096)[0]
    assert len({column.tobytes() for column in points.T}) == 1377
    with pytest.raises(ParameterError, match="from 1 to 1377"):
        Niederreiter(dims=1378)
    with pytest.warns(
        NotPowerOfTwoWarning, match="6 Niederreiter points are not balanced; 4 and 8"
    ):
        Niederreiter(dims=3).draw(6)


@pytest.mark.parametrize("bits", [0, 1, 2, 6, 10])
def test_larcher_pillichshammer_by_hand(bits):
    """x = i/n; digit r of y is the parity of the digits of i from the r-th lowest upward."""
    n = 2**bits
    points = LarcherPillichshammer().draw(n)[0]
    np.testing.assert_array_equal(points[:, 0], np.arange(n) / n)
    y = [sum(((i >> r).bit_count() % 2) / 2 ** (r + 1) for r in range(bits)) for i in range(n)]
    np.testing.assert_array_equal(points[:, 1], y)
    assert net_t_value(points) == 0


def test_larcher_pillichshammer_is_better_than_hammersley():
    """Compare star discrepancies at n = 256."""
    ours, other = (
        sampler(name, 2).draw(256)[0] for name in ("larcher-pillichshammer", "hammersley")
    )
    assert star_discrepancy(ours) < 0.8 * star_discrepancy(other)


def star_discrepancy(points):
    """Return the star discrepancy by definition: closed and open boxes on the grid."""
    xs, ys = (np.append(np.unique(c), 1.0) for c in points.T)
    volume = np.outer(xs, ys)
    closed = (points[:, 0, None] <= xs).T.astype(float) @ (points[:, 1, None] <= ys)
    open_ = (points[:, 0, None] < xs).T.astype(float) @ (points[:, 1, None] < ys)
    return max((closed / len(points) - volume).max(), (volume - open_ / len(points)).max())


def test_counts_and_dims_of_larcher_pillichshammer():
    with pytest.raises(CountError, match="nearest counts are 64 and 128"):
        LarcherPillichshammer().draw(100)
    assert LarcherPillichshammer().nearest_count(2**31 - 1) == 2**31
    with pytest.raises(ParameterError, match="it must be 2, for other dims use sobol"):
        LarcherPillichshammer(dims=3)


TERNARY = """\
d	s	a	m_i
1	1	3	1
4	2	10	1	4
2	1	4	1
3	1	5	2
"""
"""First polynomials over the field of three elements of [Ostromoukhov2024]_, degree 1 or 2."""

# Output of the authors' program for these polynomials
TERNARY_MATRICES = [
    [[1, 0, 0, 0, 0], [0, 1, 0, 0, 0], [0, 0, 1, 0, 0], [0, 0, 0, 1, 0], [0, 0, 0, 0, 1]],
    [[1, 1, 2, 2, 1], [0, 1, 0, 2, 0], [0, 0, 1, 1, 1], [0, 0, 0, 1, 0], [0, 0, 0, 0, 1]],
    [[1, 2, 1, 2, 1], [0, 1, 1, 0, 2], [0, 0, 1, 0, 0], [0, 0, 0, 1, 2], [0, 0, 0, 0, 1]],
    [[2, 2, 2, 2, 2], [0, 2, 1, 0, 2], [0, 0, 2, 0, 0], [0, 0, 0, 2, 2], [0, 0, 0, 0, 2]],
]


class TestExternalDirectionNumbers:
    """Tables of direction numbers in base 2 and base 3, with the scrambles of their base."""

    @pytest.fixture
    def ternary(self, tmp_path):
        (tmp_path / "gf3.dat").write_text(TERNARY)
        return str(tmp_path / "gf3.dat")

    def test_joe_and_kuos_table_gives_the_built_in_points(self, tmp_path):
        (tmp_path / "jk.txt").write_text(
            "d s a m_i\n2 1 0 1\n3 2 1 1 3\n4 3 1 1 3 1\n5 3 2 1 1 1\n"
        )
        source = Sobol(directions=str(tmp_path / "jk.txt"), dims=5)
        np.testing.assert_array_equal(source.draw(256), Sobol(dims=5).draw(256))
        chain, own = (sampler(f"{spec} | owen", 5) for spec in (source.spec, "sobol"))
        np.testing.assert_array_equal(chain.draw(64, rng=1), own.draw(64, rng=1))
        with pytest.raises(ParameterError, match="5"):
            Sobol(directions=str(tmp_path / "jk.txt"), dims=6)

    def test_a_table_in_another_order_with_van_der_corput_in_it(self, tmp_path):
        (tmp_path / "one.txt").write_text("d s a m_i\n0 0 0 # van der Corput\n3 2 1 1 3\n1 1 0 1\n")
        points = Sobol(directions=str(tmp_path / "one.txt"), dims=3).draw(64)
        np.testing.assert_array_equal(points, Sobol(dims=3).draw(64)[..., [0, 2, 1]])

    def test_base_3_agrees_with_the_authors_program(self, ternary):
        source = Sobol(directions=ternary, base=3, dims=4)
        columns = source.direction_numbers(1)
        np.testing.assert_array_equal(columns[:, :5, :5].transpose(0, 2, 1), TERNARY_MATRICES)
        np.testing.assert_allclose(
            source.draw(243)[0], slow_net(TERNARY_MATRICES, 3, 243), rtol=0, atol=1e-9
        )

    @pytest.mark.parametrize("step", ["owen", "lms", "digital-shift", "permute"])
    def test_scrambles_in_base_3_keep_the_net(self, ternary, step):
        chain = sampler(f"sobol(directions={ternary!r}, base=3) | {step}", 4)
        points = chain.draw(243, realizations=2, rng=1)
        assert chain.unbiased
        assert not np.array_equal(points[0], points[1])
        for x in points:
            assert [net_t_value(x[:, pair], 3) for pair in ([0, 1], [2, 3])] == [0, 0]
            assert net_t_value(x, 3) == 1
        with pytest.raises(ParameterError, match="whose digits are in base 3"):
            sampler(f"sobol(directions={ternary!r}, base=3) | owen(base=2)", 4)
        with pytest.warns(NotPowerOfTwoWarning, match="81 and 243 would be"):
            chain.draw(100, rng=1)

    @pytest.mark.parametrize(
        ("text", "base", "words"),
        [
            ("2 1 0 2\n", 2, "line 1, is not"),  # an even m
            ("d s a\n2 1 0 3\n", 2, "line 2, is not"),  # an m_1 of two digits
            ("2 3 1 1 3\n", 2, "line 1, is not"),  # too few numbers
            ("2 3 9 1 3 1\n", 2, "line 1, is not"),  # polynomial of too high a degree
            ("2 1 0 x\n", 2, "line 1, is not"),
            ("2 33 1 1\n", 2, "line 1, is not"),
            ("2 1 0 1\n", 3, "line 1, is not"),  # numbers of base 2
            ("1 1 6 1\n", 3, "line 1, is not"),  # leading coefficient 2
            ("d s a\n", 2, "holds no direction numbers"),
        ],
    )
    def test_bad_tables_are_refused(self, tmp_path, text, base, words):
        (tmp_path / "t.txt").write_text(text)
        with pytest.raises(FileFormatError, match=words):
            Sobol(directions=str(tmp_path / "t.txt"), base=base)

    def test_refusals(self, ternary):
        with pytest.raises(ParameterError, match="base 3 needs a table"):
            Sobol(base=3)
        with pytest.raises(ParameterError, match="base is 5"):
            Sobol(directions=ternary, base=5)
        with pytest.raises(FileFormatError, match="no file"):
            Sobol(directions="none.dat")
        with pytest.raises(FileFormatError, match="is not a path"):
            Sobol(directions=5)

    def test_matrices_one_below_the_other(self, tmp_path):
        file = tmp_path / "matrices.dat"
        rows = ["\n".join(" ".join(map(str, row)) for row in matrix) for matrix in TERNARY_MATRICES]
        file.write_text("# four dims\n" + "\n\n".join(rows) + "\n")
        net = DigitalNet(matrices=str(file), base=3)
        given = DigitalNet(matrices=TERNARY_MATRICES, base=3)
        np.testing.assert_array_equal(net.draw(243), given.draw(243))
        assert net.digit_bases == (3,) * 4
        assert net_t_value(net.then(Owen()).draw(243, rng=1)[0], 3) == 1
        with pytest.raises(FileFormatError, match="must be|from 0 to 1"):
            DigitalNet(matrices=str(file))  # the digit 2 is not allowed in base 2


# Their licenses are unknown, so they are not in the repository: MCSPECTRA_NETS is their folder
PUBLISHED = [
    (Path(os.environ.get("MCSPECTRA_NETS", "nowhere")) / name, base, t)
    for name, base, t in (("onetwo_init_tab.dat", 2, 1), ("quad_optimized_gf3.dat", 3, 0))
]

if all(file.is_file() for file, *_ in PUBLISHED):

    @pytest.mark.parametrize(("file", "base", "t"), PUBLISHED)
    def test_the_published_tables(file, base, t):
        """Consecutive pairs of dims are (t, 2)-sequences with the t stated in the papers."""
        net = Sobol(directions=str(file), base=base, dims=24)
        points = net.draw(base**6)[0]
        for j in range(0, 24, 2):
            assert net_t_value(points[:, j : j + 2], base) <= t
