"""The contract of samplers: every registered sampler in all its dims, and some with randomizations.

Uniformity of points is tested for registered samplers in one number of dims; randomizations have
their own tests. A new sampler is one row of `rows.ROWS`, a new randomization one entry of `CHAINS`.
Behavior of the base class (counts, dims, bad seeds) is tested once.
"""

import warnings
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import pytest
from scipy import stats
from tests.samplers.rows import ROWS, Row

import mcspectra as mcs
from mcspectra.core.errors import CountError, NotPowerOfTwoWarning, ParameterError
from mcspectra.core.streams import Stream
from mcspectra.samplers import RANDOMIZATIONS, SAMPLERS, Randomized, sampler
from mcspectra.samplers.base import MAX_COUNT, Structure
from mcspectra.samplers.optimised import OptimisedSampler

FALSE_ALARMS = 1e-6  # false-alarm probability of the whole file
GIVEN_SETS = 5

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
"""Randomizations after a sampler, and whether they make every point uniform.

{n} is the count of the case, {more} a larger allowed count of the sampler.
"""

FIXED = ("", " | strata-shift", " | skip(count={n})", " | subset")
"""Randomizations that keep a fixed set equal in every realization."""

TYPICAL = (
    "random",
    "jittered",
    "antithetic-jittered",
    "sobol",
    "faure",
    "halton",
    "hammersley",
    "rank1-lattice",
    "poisson-disk",
    "points(path='{path}')",
)
"""Samplers of every structure, with digits in several bases, before randomizations."""


@dataclass(frozen=True)
class Case:
    """A row with its dims and its randomizations."""

    row: Row
    dims: int
    chain: str = ""

    @property
    def n(self):
        return self.row.counts[self.dims]

    @property
    def fixed(self):
        return self.row.fixed and self.chain in FIXED

    @property
    def unbiased(self):
        return self.row.unbiased or CHAINS[self.chain]

    def __str__(self):
        return f"{self.row.spec}{self.chain}-{self.dims}d"


def parts_of(chain):
    """Return the names of the randomizations of a chain."""
    return [part.strip().partition("(")[0] for part in chain.split("|") if part.strip()]


def fits(row, chain):
    """Return whether every step of the chain preserves the remaining structure."""
    cls = SAMPLERS.load(row.spec.partition("(")[0])
    structure = cls.structure
    for name in parts_of(chain):
        if name == "skip" and not (cls.sequence or structure is Structure.UNKNOWN):
            return False
        if cls.antithetic and name in ("owen", "lms"):  # these separate the pairs
            return False
        structure = RANDOMIZATIONS.load(name).fits.get(structure)
    return structure is not None


def made(row, chain):
    """Return whether the chain can be drawn; digits of strata and of i/n need powers of two."""
    if "{" in chain and row.spec.startswith("points"):  # given points have no other counts
        return False
    powers = SAMPLERS.load(row.spec.partition("(")[0]).structure is Structure.STRATA
    digits = {"digital-shift", "owen", "permute", "lms"}.intersection(parts_of(chain))
    return not (powers and digits and row.counts[2].bit_count() > 1)


PLAIN = [Case(row, dims) for row in ROWS for dims in row.counts]
ONCE = [case for case in PLAIN if case.dims == max(2, min(case.row.counts))]
CHAINED = [
    Case(row, 2, chain)
    for row in ROWS
    for chain in CHAINS
    if row.spec in TYPICAL and chain and made(row, chain)
]
MISFITS = [case for case in CHAINED if not fits(case.row, case.chain)]
CHAINED = [case for case in CHAINED if fits(case.row, case.chain)]
UNIFORM = [case for case in ONCE if case.unbiased]

every_case = pytest.mark.parametrize("case", PLAIN + CHAINED, ids=str)
every_sampler = pytest.mark.parametrize("case", ONCE, ids=str)


@pytest.fixture(scope="session")
def make(tmp_path_factory):
    """Return a function that builds the sampler of a case; given points are written to a file."""
    folder = tmp_path_factory.mktemp("points")

    def build(case):
        name = case.row.spec.partition("(")[0]
        path = folder / f"{name}-{case.dims}-{case.n}.npz"
        if name == "points" and not path.exists():
            points = np.random.default_rng(case.dims).random((GIVEN_SETS, case.n, case.dims))
            np.savez(path, points=points)
        elif name == "shared-cells" and not path.exists():
            cells = np.indices((4,) * case.dims).reshape(case.dims, -1).T
            np.savez(path, cells=cells.reshape(-1, case.n, case.dims) + 1)
        spec = case.row.spec.replace("{path}", path.as_posix())
        chain = case.chain.replace("{n}", str(case.n))
        if "{more}" in chain:
            more = sampler(spec, case.dims)._counts_near(2 * case.n)[1]
            chain = chain.replace("{more}", str(more))
        return sampler(spec + chain, case.dims)

    return build


def test_rows_cover_the_registries():
    code = {"command", "python"}  # covered by test_external
    assert {row.spec.partition("(")[0] for row in ROWS} == set(SAMPLERS) - code
    assert {part for chain in CHAINS for part in parts_of(chain)} == set(RANDOMIZATIONS)
    assert {row.spec for row in ROWS} > set(TYPICAL)


@pytest.mark.parametrize("case", MISFITS, ids=str)
def test_randomizations_that_break_a_set_are_refused_with_a_reason(case, make):
    with pytest.raises(ParameterError, match=r"^[a-z-]+ would break the .* of .*; .*\.$"):
        make(case)


@every_case
def test_points_have_the_same_bits_in_any_call_and_thread_and_the_declared_properties(case, make):
    source = make(case)
    whole = source.draw(case.n, realizations=GIVEN_SETS, rng=7)
    assert whole.shape == (GIVEN_SETS, case.n, case.dims)
    assert whole.dtype == np.float64
    assert whole.flags.c_contiguous
    assert whole.flags.writeable
    assert whole.min() >= 0.0
    assert whole.max() < 1.0
    np.testing.assert_array_equal(source.draw(case.n, realizations=3, rng=7, first=1), whole[1:4])
    again = make(case)
    with ThreadPoolExecutor(4) as pool:
        parts = list(pool.map(lambda r: again.draw(case.n, rng=7, first=r)[0], range(GIVEN_SETS)))
    np.testing.assert_array_equal(parts, whole)

    # Whether a subset takes all points depends on the count
    assert (len(np.unique(whole.reshape(GIVEN_SETS, -1), axis=0)) == 1) == case.fixed
    assert source.fixed == (case.fixed and case.chain != " | subset")
    given = case.row.spec.startswith("points") and case.chain in FIXED
    assert np.array_equal(whole[:1], source.draw(case.n, rng=8)) == (case.fixed or given)

    # Compare the declared properties with the points
    assert source.unbiased == case.unbiased
    assert source.check_count(case.n) == case.n
    assert source.nearest_count(case.n) == case.n
    same = sampler(source.spec, case.dims)
    assert same == source
    assert same.spec == source.spec
    assert same.dims == case.dims


@pytest.mark.parametrize(
    "case",
    [
        # Descent to a target differs from `step-blue-noise` in the target alone
        pytest.param(case, marks=pytest.mark.slow) if case.row.spec.startswith("target-") else case
        for case in UNIFORM
    ],
    ids=str,
)
def test_every_point_is_uniform(case, make):
    level = 1 - (1 - FALSE_ALARMS) ** (1 / len(UNIFORM))
    assert p_of_uniformity(make(case), case.n, case.dims) > level


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
def test_the_uniformity_test_detects_bias_within_strata(spec, dims, n):
    assert p_of_uniformity(sampler(spec, dims), n, dims) < FALSE_ALARMS / len(UNIFORM)


def p_of_uniformity(source, n, dims):
    """Least p of χ² tests over 35 cells of one point per realization, for pairs of neighbor axes.

    5 × 7 cells differ from the strata of every set here, so that strata do not hide their interior.
    """
    # 10 per cell, or 5 if each set takes long: the least for which χ² has its distribution
    realizations = 175 if isinstance(source, OptimisedSampler) else 350
    points = source.draw(n, realizations=realizations, rng=20)
    picked = np.random.default_rng(dims).integers(n, size=realizations)
    x = points[np.arange(realizations), picked]
    if dims == 1:
        cells = [35 * x[:, 0]]
    else:
        cells = [7 * np.floor(5 * x[:, j]) + np.floor(7 * x[:, j - 1]) for j in range(dims)]
    counts = [np.bincount(each.astype(int), minlength=35) for each in cells]
    return len(cells) * min(stats.chisquare(count).pvalue for count in counts)


@every_sampler
def test_dims_and_counts_beyond_the_limits_are_refused(case, make):
    for dims in (0, 1.5):
        with pytest.raises(ParameterError, match="dims"):
            sampler(case.row.spec, dims)
    source = make(case)
    largest = source.nearest_count(source.max_count)
    assert largest <= source.max_count <= MAX_COUNT
    for n in (0, 2**32):
        with pytest.raises(CountError, match="n is"):
            source.draw(n)
    if source.max_count < MAX_COUNT:
        with pytest.raises(CountError, match=f"{source.max_count}") as error:
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
    with pytest.raises(CountError, match=str(nearest)) as error:
        source.draw(1)
    assert error.value.nearest == (nearest,)


# Behavior of the base class, tested for a sampler of any count, one of few counts, and a chain
BASES = ["random", "jittered", "sobol | owen"]


@pytest.mark.parametrize("spec", BASES)
@pytest.mark.parametrize("n", [0, -1, 2.5, "x", True, None, float("nan"), float("inf"), 2**32])
def test_impossible_counts(spec, n):
    with pytest.raises(CountError, match=r"^n is .*; give a whole number"):
        sampler(spec).draw(n)


@pytest.mark.parametrize("spec", BASES)
@pytest.mark.parametrize("dims", [0, -1, 1.5, True, "x", float("nan")])
def test_impossible_dims(spec, dims):
    with pytest.raises(ParameterError, match="dims"):
        sampler(spec, dims)
    with pytest.raises(ParameterError, match="random: dims"):
        mcs.samplers.Random(dims=dims)


@pytest.mark.parametrize("spec", BASES)
@pytest.mark.parametrize(
    "arguments", [{"realizations": 0}, {"realizations": 1.5}, {"first": -1}, {"rng": -1}]
)
def test_impossible_realizations(spec, arguments):
    with pytest.raises(ParameterError, match=next(iter(arguments))):
        sampler(spec).draw(16, **arguments)


@pytest.mark.parametrize("spec", BASES)
def test_too_many_numbers_are_refused_before_they_are_made(spec):
    with pytest.raises(CountError, match="at a time"):
        sampler(spec).draw(16, realizations=2**31)


@pytest.mark.parametrize("spec", ["random", "antithetic-jittered", "latin-hypercube"])
@pytest.mark.parametrize("name", list(RANDOMIZATIONS))
def test_randomizations_do_not_change_their_input(spec, name):
    points = sampler(spec).draw(18, realizations=2, rng=1)
    before = points.copy()
    RANDOMIZATIONS.load(name)().apply(points, Stream(5), 0)
    np.testing.assert_array_equal(points, before)


@pytest.mark.parametrize("spec", ["random", "sobol"])
@pytest.mark.parametrize("name", list(RANDOMIZATIONS))
def test_then_is_the_chain_of_the_spec_string(spec, name):
    source = sampler(spec)
    chained, spelled = source.then(RANDOMIZATIONS.load(name)()), sampler(f"{spec} | {name}")
    assert isinstance(chained, Randomized)
    assert chained == spelled
    np.testing.assert_array_equal(
        chained.draw(16, realizations=3, rng=4), spelled.draw(16, realizations=3, rng=4)
    )


def test_then_requires_a_randomization():
    with pytest.raises(ParameterError, match="not a randomization"):
        mcs.samplers.Random(dims=2).then("shift")
