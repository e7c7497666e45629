"""The contract of samplers: every registered one, plain and after every randomisation.

A new sampler is one row of `rows.ROWS`; a new randomisation one entry of `CHAINS`.
"""

from __future__ import annotations

import warnings
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import pytest
from scipy import stats
from tests.samplers.rows import ROWS, Row

import mcspectra as mcs
from mcspectra.core.errors import CountError, NotPowerOfTwoWarning, ParameterError
from mcspectra.samplers import RANDOMIZATIONS, SAMPLERS, Randomized, Structure, sampler
from mcspectra.samplers.base import MAX_COUNT
from mcspectra.samplers.optimised import OptimisedSampler

FALSE_ALARMS = 1e-6  # for the whole file
GIVEN_SETS = 8


CHAINS = {
    "": False,
    " | shift": True,
    " | digital-shift": True,
    " | owen": True,
    " | permute": True,
    " | lms": True,
    " | strata-shift": False,
    " | strata-shift(offset=0.25) | shift": True,
    " | decorrelate": True,
    " | mirror": False,
    " | random-rotation": False,
    " | shuffle": False,
    " | skip(count={n})": False,
    " | subset": False,
    " | subset(of={more})": False,
    " | mirror | shift": True,
}
"""What follows the sampler, and whether it makes every point uniform.

{n} is the count of the case, {more} a larger one that the sampler can make.
"""

FIXED = ("", " | strata-shift", " | skip(count={n})", " | subset")
"""What leaves a fixed set the same in every realisation."""


@dataclass(frozen=True)
class Case:
    """A row with its dims and what follows it."""

    row: Row
    dims: int
    chain: str

    @property
    def n(self) -> int:
        return self.row.counts[self.dims]

    @property
    def fixed(self) -> bool:
        return self.row.fixed and self.chain in FIXED

    @property
    def unbiased(self) -> bool:
        return self.row.unbiased or CHAINS[self.chain]

    def __str__(self) -> str:
        return f"{self.row.spec}{self.chain}-{self.dims}d"


def parts_of(chain):
    """Names of the randomisations of a chain."""
    return [part.strip().partition("(")[0] for part in chain.split("|") if part.strip()]


def fits(row, chain):
    """Whether every step of the chain keeps what the steps before it have left."""
    cls = SAMPLERS.load(row.spec.partition("(")[0])
    structure = cls.structure
    for name in parts_of(chain):
        if name == "skip" and not (cls.sequence or structure is Structure.UNKNOWN):
            return False
        if cls.antithetic and name in ("owen", "lms"):  # these part the pairs
            return False
        structure = RANDOMIZATIONS.load(name).fits.get(structure)
    return structure is not None


def made(row, dims, chain):
    """Whether the chain can be tried: the count is possible, and optimising takes no minutes."""
    name = row.spec.partition("(")[0]
    if issubclass(SAMPLERS.load(name), OptimisedSampler) and chain not in ("", " | shift"):
        return False
    if "{" in chain and (name in ("points", "digital-net", "mitsuba") or "sides=" in row.spec):
        return False  # these have no more points, or not so many
    if "{more}" in chain and dims > 3:  # the next grid of 10 dims has 59,049 points
        return False
    # Digits of strata, and of the n-ths of hammersley, keep powers of two only.
    powers = SAMPLERS.load(name).structure is Structure.STRATA or name == "hammersley"
    digits = {"digital-shift", "owen", "permute", "lms"}.intersection(parts_of(chain))
    return not (powers and digits and row.counts[dims].bit_count() > 1)


TYPICAL = (
    "random",
    "jittered",
    "sobol",
    "faure",
    "halton",
    "rank1-lattice",
    "latin-hypercube",
    "points(path='{path}')",
)
"""Samplers of every structure, with digits in several bases: the randomisations follow these in many
dims too, the others in 2-D."""


def dims_of(row, chain):
    """Dims to try: all of the sampler alone; of a chain two of them, for most samplers one."""
    if not chain:
        return list(row.counts)
    usual, most = 2 if 2 in row.counts else min(row.counts), max(row.counts)
    return sorted({usual, most} if row.spec in TYPICAL or chain == " | shift" else {usual})


ALL = [
    Case(row, dims, chain)
    for row in ROWS
    for chain in CHAINS
    for dims in dims_of(row, chain)
    if made(row, dims, chain)
]
CASES = [case for case in ALL if fits(case.row, case.chain)]
MISFITS = [case for case in ALL if not fits(case.row, case.chain)]
PLAIN = [case for case in CASES if not case.chain and case.dims == max(2, min(case.row.counts))]

every_case = pytest.mark.parametrize("case", CASES, ids=str)
every_sampler = pytest.mark.parametrize("case", PLAIN, ids=str)


@pytest.fixture(scope="session")
def make(tmp_path_factory):
    """Build the sampler of a case; given points are written to a file first."""
    folder = tmp_path_factory.mktemp("points")

    def build(case):
        path = folder / f"{case.dims}-{case.n}.npz"
        if not path.exists():
            points = np.random.default_rng(case.dims).random((GIVEN_SETS, case.n, case.dims))
            np.savez(path, points=points)
        spec = case.row.spec.replace("{path}", path.as_posix())
        if "{more}" in case.chain:
            more = sampler(spec, case.dims)._counts_near(2 * case.n)[1]
            return sampler(spec + case.chain.replace("{more}", str(more)), case.dims)
        return sampler(spec + case.chain.replace("{n}", str(case.n)), case.dims)

    return build


def test_rows_cover_the_registries():
    assert {row.spec.partition("(")[0] for row in ROWS} == set(SAMPLERS)
    assert {part for chain in CHAINS for part in parts_of(chain)} == set(RANDOMIZATIONS)


@pytest.mark.parametrize("case", MISFITS, ids=str)
def test_randomizations_that_break_a_set_are_refused_with_a_reason(case, make):
    with pytest.raises(ParameterError, match=r"^[a-z-]+ would break the .* of .*; .*\.$"):
        make(case)


@every_case
def test_points_are_float64_of_the_asked_shape_within_the_unit_cube(case, make):
    points = make(case).draw(case.n, realizations=GIVEN_SETS, rng=1)
    assert points.shape == (GIVEN_SETS, case.n, case.dims)
    assert points.dtype == np.float64
    assert points.flags.c_contiguous
    assert points.flags.writeable
    assert points.min() >= 0.0
    assert points.max() < 1.0


@every_case
def test_realizations_do_not_depend_on_the_call_that_draws_them(case, make):
    source = make(case)
    whole = source.draw(case.n, realizations=6, rng=7)
    pieces = [source.draw(case.n, realizations=k, rng=7, first=r) for r, k in ((0, 1), (1, 3))]
    np.testing.assert_array_equal(np.concatenate(pieces), whole[:4])
    np.testing.assert_array_equal(make(case).draw(case.n, rng=7, first=5)[0], whole[5])


@every_case
def test_realizations_and_seeds_differ_unless_the_set_is_fixed(case, make):
    source = make(case)
    seven = source.draw(case.n, realizations=4, rng=7)
    eight = source.draw(case.n, realizations=4, rng=8)
    same = len(np.unique(seven.reshape(4, -1), axis=0)) == 1
    assert same == case.fixed
    # That a subset of all points is no choice is not known before the count is.
    assert source.fixed == (case.fixed and case.chain != " | subset")
    given = case.row.spec.startswith("points") and case.chain in FIXED
    assert np.array_equal(seven, eight) == (case.fixed or given)


@pytest.mark.parametrize("case", [case for case in CASES if case.unbiased], ids=str)
def test_every_point_is_uniform(case, make):
    assert p_of_uniformity(make(case), case.n, case.dims) > 1 - (1 - FALSE_ALARMS) ** (
        1 / len(CASES)
    )


@pytest.mark.parametrize(
    "spec",
    [
        "regular",
        "regular(position='corner')",
        "box-jitter(width=0.2)",
        "gaussian-jitter(width=0.1)",
    ],
)
@pytest.mark.parametrize(("dims", "n"), [(1, 16), (2, 16), (3, 64)])
def test_that_test_sees_bias_within_strata(spec, dims, n):
    assert p_of_uniformity(sampler(spec, dims), n, dims) < FALSE_ALARMS / len(CASES)


def p_of_uniformity(source, n, dims):
    """χ² over 35 cells, of one point picked from each realisation: least p of all pairs of neighbours.

    5 × 7 cells are not those of any set here, so that strata do not hide what is within them.
    """
    # 40 a cell, or 20 where sets are large or take an optimisation each
    optimised = isinstance(
        source.base if isinstance(source, Randomized) else source, OptimisedSampler
    )
    realizations = 700 if n > 100 or optimised else 1400
    points = source.draw(n, realizations=realizations, rng=20)
    picked = np.random.default_rng(dims).integers(n, size=realizations)
    x = points[np.arange(realizations), picked]
    if dims == 1:
        cells = [35 * x[:, 0]]
    else:
        cells = [7 * np.floor(5 * x[:, j]) + np.floor(7 * x[:, j - 1]) for j in range(dims)]
    counts = [np.bincount(each.astype(int), minlength=35) for each in cells]
    return len(cells) * min(stats.chisquare(count).pvalue for count in counts)


@every_case
def test_what_a_sampler_says_of_itself_is_true(case, make):
    source = make(case)
    assert source.unbiased == case.unbiased
    assert source.check_count(case.n) == case.n
    assert source.nearest_count(case.n) == case.n
    again = sampler(source.spec, case.dims)
    assert again == source
    assert again.spec == source.spec
    assert again.dims == case.dims


@every_sampler
@pytest.mark.parametrize("n", [0, -1, 2.5, "x", True, None, float("nan"), float("inf"), 2**32])
def test_impossible_counts(case, make, n):
    with pytest.raises(CountError, match=r"^n is .*; give a whole number"):
        make(case).draw(n)


@every_sampler
@pytest.mark.parametrize("dims", [0, -1, 1.5, True, "x", float("nan")])
def test_impossible_dims(case, dims):
    with pytest.raises(ParameterError, match="dims"):
        sampler(case.row.spec, dims)


@every_sampler
@pytest.mark.parametrize(
    "arguments", [{"realizations": 0}, {"realizations": 1.5}, {"first": -1}, {"rng": -1}]
)
def test_impossible_realizations(case, make, arguments):
    with pytest.raises(ParameterError, match=next(iter(arguments))):
        make(case).draw(case.n, **arguments)


@every_sampler
def test_too_many_numbers_are_refused_before_they_are_made(case, make):
    with pytest.raises(CountError, match="at a time"):
        make(case).draw(case.n, realizations=2**31)


@every_sampler
def test_counts_beyond_the_largest_are_refused_with_it(case, make):
    source = make(case)
    largest = source.nearest_count(source.max_count)
    assert largest <= source.max_count <= MAX_COUNT
    if source.max_count < MAX_COUNT:
        with pytest.raises(CountError, match=f"makes at most {source.max_count} points") as error:
            source.draw(source.max_count + 1)
        assert error.value.nearest == (source.max_count,)


@every_sampler
def test_counts_named_in_a_refusal_can_be_drawn(case, make):
    source = make(case)
    for n in range(1, 24):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NotPowerOfTwoWarning)
            try:
                source.check_count(n)
            except CountError as error:
                for count in error.nearest:
                    if count <= 64:
                        drawn = source.draw(count, rng=n)
                        assert drawn.shape == (1, count, case.dims), (n, count)


@every_sampler
def test_one_point_is_made_or_refused_with_the_nearest_count(case, make):
    source = make(case)
    nearest = source.nearest_count(1)
    if nearest == 1:
        assert source.draw(1, realizations=2, rng=1).shape == (2, 1, case.dims)
        return
    with pytest.raises(CountError, match=rf"nearest count is {nearest}\.") as error:
        source.draw(1)
    assert error.value.nearest == (nearest,)


@every_sampler
def test_threads_draw_the_same_bits(case, make):
    source = make(case)
    whole = source.draw(case.n, realizations=8, rng=7)
    with ThreadPoolExecutor(4) as pool:
        parts = list(pool.map(lambda r: source.draw(case.n, rng=7, first=r)[0], range(8)))
    np.testing.assert_array_equal(parts, whole)


@every_sampler
@pytest.mark.parametrize("name", list(RANDOMIZATIONS))
def test_randomizations_leave_their_input_alone(case, make, name):
    source = make(case)
    step = RANDOMIZATIONS.load(name)()
    points = source.draw(case.n, realizations=2, rng=1)
    before = points.copy()
    step.apply(points, mcs.core.streams.Stream(5), 0)
    np.testing.assert_array_equal(points, before)


@pytest.mark.parametrize(
    ("case", "name"),
    [
        (case, name)
        for case in PLAIN
        for name in RANDOMIZATIONS
        if fits(case.row, name) and made(case.row, case.dims, name)
    ],
    ids=str,
)
def test_then_is_the_chain_of_the_spec_string(case, name, make):
    source = make(case)
    chained = source.then(RANDOMIZATIONS.load(name)())
    spelled = sampler(f"{source.spec} | {name}", case.dims)
    assert isinstance(chained, Randomized)
    assert chained == spelled
    np.testing.assert_array_equal(
        chained.draw(case.n, realizations=3, rng=4), spelled.draw(case.n, realizations=3, rng=4)
    )


def test_then_wants_a_randomization():
    with pytest.raises(ParameterError, match="not a randomisation"):
        mcs.samplers.Random(dims=2).then("shift")
