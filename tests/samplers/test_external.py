"""Points from outside: arrays, files, callables and the engines of scipy.stats.qmc."""

import pickle
import sys

import numpy as np
import pytest
from scipy import stats
from scipy.stats import qmc
from tests.processes import python

import mcspectra as mcs
from mcspectra.core.errors import (
    ConfigError,
    CountError,
    DomainError,
    FileFormatError,
    McspectraError,
    ParameterError,
    SpecError,
)
from mcspectra.core.pointfiles import write_points
from mcspectra.core.spec import short_spec
from mcspectra.quality.nets import net_t_value
from mcspectra.samplers import (
    CommandSampler,
    FunctionSampler,
    GivenPoints,
    Owen,
    PythonSampler,
    ScipySampler,
    Shift,
    external,
    sampler,
)
from mcspectra.samplers.law import bases_to_scramble
from mcspectra.testing import check_sampler

FALSE_ALARMS = 1e-6
CHECKS = 8  # number of statistical tests in this file
LEVEL = 1 - (1 - FALSE_ALARMS) ** (1 / CHECKS)  # Šidák

SETS = np.random.default_rng(0).random((3, 5, 2))


@pytest.fixture
def files(tmp_path):
    """Write two files, of two sets and of one set."""
    write_points(tmp_path / "a.dat", SETS[:2])
    write_points(tmp_path / "b.bin", SETS[2:])
    return [str(tmp_path / "a.dat"), str(tmp_path / "b.bin")]


def refused(error, words, function, *args, **kwargs):
    """Check that the call raises `error` with one sentence that has these words."""
    with pytest.raises(error, match=words) as caught:
        function(*args, **kwargs)
    text = str(caught.value)
    assert isinstance(caught.value, McspectraError)
    assert "\n" not in text
    assert text.endswith(".")


class TestGivenPoints:
    """Realization r is set r, unless a randomization makes the sets reusable."""

    def test_sets_come_in_order_whatever_the_seed(self, files):
        for source in (
            mcs.Sampler.from_points(SETS),
            mcs.Sampler.from_files(*files),
            GivenPoints.from_sets(list(SETS), "somewhere"),
            sampler(f"points(path={files!r})"),
        ):
            np.testing.assert_array_equal(source.draw(5, realizations=3, rng=1), SETS)
            np.testing.assert_array_equal(source.draw(5, first=1, realizations=2), SETS[1:])
            assert (source.dims, source.unbiased) == (2, False)

    def test_one_set(self):
        source = mcs.Sampler.from_points(SETS[0].tolist())
        np.testing.assert_array_equal(source.draw(5), SETS[:1])
        assert sampler("points(points=[[0.5], [0.25]])", 1).draw(2).tolist() == [[[0.5], [0.25]]]

    def test_points_are_copied_in_and_out(self):
        mine = SETS.copy()
        source = mcs.Sampler.from_points(mine)
        mine[:] = 0.0
        drawn = source.draw(5, realizations=3)
        np.testing.assert_array_equal(drawn, SETS)
        drawn[:] = 0.0
        np.testing.assert_array_equal(source.draw(5, realizations=3), SETS)
        with pytest.raises(ValueError, match="read-only"):
            source.points[0, 0, 0] = 0.5

    def test_points_that_were_not_given_are_an_error(self, files):
        source = mcs.Sampler.from_files(*files)
        refused(
            CountError, "holds 3 realizations, but 4 are needed", source.draw, 5, realizations=4
        )
        refused(CountError, "holds 3 realizations, but 4 are needed", source.draw, 5, first=3)
        for n in (4, 6):
            refused(CountError, f"cannot make {n} points; the nearest count is 5", source.draw, n)
            assert source.nearest_count(n) == 5
        assert source.nearest_count(2**31) == 5

    @pytest.mark.parametrize("name", ["shift", "digital-shift", "owen"])
    def test_one_set_is_enough_before_a_uniform_randomization(self, files, name):
        chain = sampler(f"points(path={files[1]!r}) | {name}")
        points = chain.draw(5, realizations=100, rng=1)
        assert len(np.unique(points.reshape(100, -1), axis=0)) == 100
        assert chain.unbiased
        np.testing.assert_array_equal(chain.draw(5, realizations=3, first=60, rng=1), points[60:63])

    def test_several_sets_are_used_in_turn(self):
        chain = mcs.Sampler.from_points(SETS).then(Shift())
        points = chain.draw(5, realizations=7, rng=2)
        for r, x in enumerate(points):
            moved = (x - SETS[r % 3]) % 1.0
            spread = np.abs(moved - moved[0])
            assert np.minimum(spread, 1 - spread).max() < 1e-15

    def test_a_fixed_shift_does_not_multiply_sets(self):
        source = mcs.Sampler.from_points(SETS)
        fixed = source.then(mcs.samplers.StrataShift())
        refused(CountError, "holds 3 realizations", fixed.draw, 5, realizations=4)
        assert fixed.then(Shift()).draw(5, realizations=4, rng=1).shape == (4, 5, 2)

    def test_cycle_on_request(self, files):
        source = sampler(f"points(path={files!r}, cycle=True)")
        np.testing.assert_array_equal(source.draw(5, realizations=7), SETS[[0, 1, 2, 0, 1, 2, 0]])

    def test_spec_and_digest(self, files):
        source = mcs.Sampler.from_files(*files)
        assert sampler(source.spec) == source
        assert source.digest == mcs.Sampler.from_points(SETS).digest
        assert len(source.digest) == 12
        assert source.digest != mcs.Sampler.from_points(SETS[:, ::-1]).digest
        assert source.digest != mcs.Sampler.from_points(SETS.reshape(5, 3, 2)).digest
        assert mcs.Sampler.from_points(SETS) == mcs.Sampler.from_points(SETS.copy())
        assert mcs.Sampler.from_points(SETS) != mcs.Sampler.from_points(SETS[:2])
        assert len({source, sampler(source.spec)}) == 1
        assert "3x5x2" in mcs.Sampler.from_points(SETS).spec
        assert pickle.loads(pickle.dumps(source)) == source

    @pytest.mark.parametrize(
        ("points", "error", "words"),
        [
            ([], DomainError, "at least one point"),
            (np.zeros((0, 2)), DomainError, "at least one point"),
            (0.5, DomainError, r"shape \(\)"),
            ([0.5, 0.25], ParameterError, r"shape \(2,\); give \(n, d\), or \(R, n, d\)"),
            (np.zeros((1, 1, 1, 1)), ParameterError, r"shape \(1, 1, 1, 1\)"),
            ([[0.5, 1.0]], DomainError, r"must lie in \[0,1\)"),
            ([[0.5, -1e-9]], DomainError, r"must lie in \[0,1\)"),
            ([[0.5, np.nan]], DomainError, "NaN"),
            ([[0.5, np.inf]], DomainError, "infinite"),
            ([["a", "b"]], DomainError, "not an array of real numbers"),
            ([[0.5], [0.5, 0.25]], DomainError, "not an array of real numbers"),
            (None, DomainError, "."),
        ],
    )
    def test_bad_arrays(self, points, error, words):
        refused(error, words, mcs.Sampler.from_points, points)

    def test_bad_files(self, tmp_path, files):
        refused(FileFormatError, "no-such.dat", mcs.Sampler.from_files, "no-such.dat")
        refused(ParameterError, "needs a file", mcs.Sampler.from_files)
        refused(ParameterError, "path is 5", GivenPoints, path=5)
        refused(ParameterError, "path is", GivenPoints, path=["a.dat", 5])
        refused(ParameterError, "cycle is 1", GivenPoints, path=files[0], cycle=1)
        refused(ParameterError, "2 dims, but 3 dims", sampler, f"points(path={files[0]!r})", 3)
        refused(ParameterError, "dims is 0", sampler, f"points(path={files[0]!r})", 0)
        (tmp_path / "c.dat").write_text("0.1 0.2\n#\n0.3\n0.5\n")
        uneven = str(tmp_path / "c.dat")
        refused(
            ParameterError, r"Set 2 \(of .*c.dat\) is in 1 dim,", mcs.Sampler.from_files, uneven
        )
        (tmp_path / "d.dat").write_text("0.1 1.5\n")
        refused(
            DomainError, "d.dat run from 0.1 to 1.5", mcs.Sampler.from_files, tmp_path / "d.dat"
        )


@pytest.fixture
def folder(tmp_path):
    """Write sets of 4 and 16 points to files with their counts in the name, and another file."""
    rng = np.random.default_rng(1)
    sets = {}
    for n, k, extension in ((4, 2, "dat"), (4, 10, "npy"), (16, 1, "csv")):
        sets[n, k] = rng.random((n, 2))
        write_points(tmp_path / f"n{n}_{k}.{extension}", [sets[n, k]])
    (tmp_path / "notes.txt").write_text("nothing\n")
    return tmp_path, sets


class TestPatterns:
    """A folder or a pattern stands for the sets of many files, with the counts of these sets."""

    @pytest.mark.parametrize("pattern", ["", "n*_*", "n{n}_*", "n?*_?*"])
    def test_sets_are_grouped_by_their_counts(self, folder, pattern):
        root, sets = folder
        source = sampler(f"points(path={str(root / pattern)!r}, name='mine')")
        # 2 before 10: numbers in names are ordered by value
        np.testing.assert_array_equal(
            source.draw(4, realizations=2), np.stack([sets[4, 2], sets[4, 10]])
        )
        np.testing.assert_array_equal(source.draw(16)[0], sets[16, 1])
        assert [source.nearest_count(n) for n in (1, 9, 11, 10**6)] == [4, 4, 16, 16]
        refused(CountError, "nearest counts are 4 and 16", source.draw, 8)
        refused(CountError, "1 realization of 16 points", source.draw, 16, realizations=2)
        assert source.then(Shift()).draw(16, realizations=5, rng=1).shape == (5, 16, 2)
        assert sampler(source.spec) == source
        again = pickle.loads(pickle.dumps(source))
        np.testing.assert_array_equal(again.draw(16), source.draw(16))
        assert short_spec(f"{source.spec} | shift") == "mine | shift"
        assert short_spec("sobol(directions='a/b c/joe.txt') | owen") == "sobol('joe.txt') | owen"

    def test_a_pattern_selects_matching_files(self, folder):
        root, _ = folder
        assert list(sampler(f"points(path={str(root / 'n4_*')!r})").sets) == [4]
        assert len(sampler(f"points(path={str(root / 'n{n}_2.*')!r})").sets[4]) == 1

    def test_analyses_take_the_sets_of_their_count(self, folder):
        root, sets = folder
        figures = mcs.quality_figures(
            f"points(path={str(root)!r})", 4, figures=["star_discrepancy"]
        )
        expected = [
            float(mcs.quality_figures(sets[4, k])["star_discrepancy"].values[0]) for k in (2, 10)
        ]
        np.testing.assert_array_equal(figures["star_discrepancy"], expected)

    def test_refusals(self, folder):
        root, _ = folder
        read = mcs.Sampler.from_files
        refused(FileFormatError, "No file matches .*m\\*", read, root / "m*.dat")
        (root / "empty").mkdir()
        refused(FileFormatError, "empty holds no point set", read, root / "empty")
        write_points(root / "n5_1.dat", [SETS[0][:4]])
        refused(FileFormatError, "a set of 4 points, but n is 5", read, root / "n{n}_*")
        write_points(root / "n6_1.dat", [np.full((6, 3), 0.5)])
        refused(ParameterError, "is in 3 dims, but the first in 2", read, root / "n*_*")
        refused(ParameterError, "name is 5", GivenPoints, path=str(root / "n4_2.dat"), name_=5)


def draw_uniform(n, generator):
    return generator.random((n, 3))


def draw_too_few(n, generator):
    return generator.random((n - 1, 2))


def draw_never(n, generator):
    raise RuntimeError("no more ink")


def draw_and_leave(n, rng):
    raise SystemExit(3)


class TestPythonSampler:
    """A function given by name, which must be allowed before a spec may name it."""

    NAME = f"{__name__}:draw_uniform"

    def test_points_equal_those_of_the_function(self):
        source = PythonSampler(function=self.NAME, dims=3)
        given = mcs.Sampler.from_function(draw_uniform, dims=3)
        np.testing.assert_array_equal(
            source.draw(8, realizations=3, rng=4), given.draw(8, realizations=3, rng=4)
        )
        assert sampler(f"python({self.NAME!r})", 3) == source  # Python made it before
        assert sampler(source.spec, 3) == source
        assert source.unbiased
        assert not PythonSampler(function=self.NAME, dims=3, unbiased_=False).unbiased
        check_sampler(source, counts=(4, 16))

    def test_refusals(self):
        refused(ConfigError, "--allow-code os:getcwd", sampler, "python('os:getcwd')")
        refused(ParameterError, "write 'module:function'", lambda: PythonSampler(function="os"))
        refused(
            ParameterError,
            "no_such.*PYTHONPATH",
            lambda: PythonSampler(function="no_such_module:f"),
        )
        refused(ParameterError, "not a function", lambda: PythonSampler(function="os:sep"))
        few = PythonSampler(function=f"{__name__}:draw_too_few")
        refused(CountError, "returned 3 of 4", few.draw, 4)
        never = PythonSampler(function=f"{__name__}:draw_never")
        refused(CountError, "cannot make 4 points: no more ink", never.draw, 4)
        leaves = PythonSampler(function=f"{__name__}:draw_and_leave")
        refused(CountError, "cannot make 4 points: 3", leaves.draw, 4)


PROGRAM = """\
#!{python}
import random, sys, time
n, seed, how = int(sys.argv[1]), int(sys.argv[2]), sys.argv[3] if len(sys.argv) > 3 else ""
random.seed(seed)
for k in range(n - (how == "few") + (how == "many")):
    print(random.random() + (how == "out"), random.random(), *([0.5] if how == "wide" else []))
if how == "nan":
    print("nan", 0.5)
if how == "talk":
    print("Hello, world")
if how == "late":
    sys.stdout.flush()
    time.sleep(60)
if how == "endless":
    while True:
        print("0.5 0.5")
if how == "fail":
    print("Traceback of mine", file=sys.stderr)
    sys.exit("it has no n that is odd")
"""


@pytest.fixture
def program(tmp_path):
    """Write a program that prints uniform points and fails on request."""
    file = tmp_path / "mine"
    file.write_text(PROGRAM.format(python=sys.executable))
    file.chmod(0o755)
    return str(file)


class TestCommandSampler:
    """A program that prints points, run once per realization."""

    def test_realizations_are_keyed_by_the_seed(self, program):
        source = mcs.Sampler.from_command(f"{program} {{n}} {{seed}}", dims=2)
        whole = source.draw(4, realizations=5, rng=3)
        np.testing.assert_array_equal(source.draw(4, realizations=2, first=2, rng=3), whole[2:4])
        assert len(np.unique(whole)) == whole.size
        assert not np.array_equal(source.draw(4, rng=4)[0], whole[0])
        assert source.unbiased
        assert sampler(source.spec, 2) == source
        assert pickle.loads(pickle.dumps(source)) == source

    def test_the_output_is_read_as_numbers(self, program):
        import random

        source = mcs.Sampler.from_command(f"{program} {{n}} 7", dims=2)
        random.seed(7)
        expected = [[random.random(), random.random()] for _ in range(3)]
        np.testing.assert_array_equal(source.draw(3)[0], expected)

    def test_without_a_seed_it_runs_once_per_draw(self, program, monkeypatch):
        source = mcs.Sampler.from_command(f"{program} {{n}} 7", dims=2)
        runs = []
        printed = external._output_of
        monkeypatch.setattr(external, "_output_of", lambda *a: runs.append(1) or printed(*a))
        sets = source.draw(4, realizations=3, rng=1)
        assert (len(runs), source.fixed, source.unbiased) == (1, True, False)
        np.testing.assert_array_equal(sets[0], sets[2])
        assert source.then(Shift()).unbiased

    @pytest.mark.parametrize(
        ("how", "error", "words"),
        [
            ("few", CountError, "returned 3 of 4 points"),
            ("many", ParameterError, r"returned shape \(5, 2\)"),
            ("wide", ParameterError, r"returned shape \(4, 3\)"),
            ("out", DomainError, r"must lie in \[0,1\)"),
            ("nan", FileFormatError, "line 5: 'nan' is not a finite number"),
            ("talk", FileFormatError, "'Hello' is not a finite number"),
            ("fail", ParameterError, "ended with exit code 1: it has no n that is odd"),
            ("endless", ParameterError, "printed more than"),
        ],
    )
    def test_bad_output_and_failures_are_errors(self, program, how, error, words):
        source = mcs.Sampler.from_command(f"{program} {{n}} {{seed}} {how}", dims=2)
        refused(error, words, source.draw, 4, rng=1)

    def test_a_program_that_does_not_end_is_stopped(self, program):
        source = CommandSampler(run=f"{program} {{n}} {{seed}} late", timeout=0.5)
        refused(ParameterError, "took more than 0.5 s", source.draw, 4, rng=1)

    def test_refusals(self, program):
        refused(
            ConfigError, r"--allow-code './mine \{n\} \{seed\}'", sampler,
            "command('./mine {n} {seed}')",
        )  # fmt: skip
        refused(ParameterError, "{k} stands for nothing", CommandSampler, run="./mine {k}")
        for run in ("", "'./mine", 5):
            refused(ParameterError, "write a program", CommandSampler, run=run)
        absent = CommandSampler(run="./no-such-program {n}")
        refused(ParameterError, "cannot be run: No such file", absent.draw, 4)
        refused(SpecError, "was given 'a' without a name", sampler, "command('a', 'b')")
        refused(SpecError, "given run twice", sampler, "command('a', run='b')")

    def test_a_program_is_allowed_with_any_arguments(self, program):
        spec = f"command('{program} {{n}} {{seed}} x')"
        refused(ConfigError, "--allow-code", sampler, spec)
        mcs.samplers.allow_code(program)
        assert sampler(spec).dims == 2


class TestFunctionSampler:
    """A callable gets a fresh generator for each realization."""

    def test_realizations_are_reproducible_and_differ(self):
        source = mcs.Sampler.from_function(draw_uniform, dims=3)
        whole = source.draw(8, realizations=6, rng=1)
        assert whole.shape == (6, 8, 3)
        np.testing.assert_array_equal(source.draw(8, realizations=2, first=3, rng=1), whole[3:5])
        assert len(np.unique(whole)) == whole.size
        assert source.unbiased
        assert not FunctionSampler(function=draw_uniform, dims=3, unbiased_=False).unbiased
        assert source.then(Shift()).draw(8, rng=1).shape == (1, 8, 3)

    def test_the_spec_names_the_function_without_its_address(self):
        spec = mcs.Sampler.from_function(draw_uniform, dims=3).spec
        assert spec.startswith("function(")
        assert spec.endswith("draw_uniform)")
        assert " at 0x" not in mcs.Sampler.from_function(np.vectorize(abs), dims=1).spec

    @pytest.mark.parametrize(
        ("draw", "error", "words"),
        [
            (lambda n, g: g.random((n, 3)), ParameterError, r"shape \(4, 3\); \(4, 2\) is needed"),
            (lambda n, g: g.random(n), ParameterError, r"shape \(4,\)"),
            (lambda n, g: g.random((n + 1, 2)), ParameterError, r"shape \(5, 2\)"),
            (lambda n, g: g.random((n - 1, 2)), CountError, "returned 3 of 4 points"),
            (lambda n, g: g.random((n, 2)) + 0.9, DomainError, r"must lie in \[0,1\)"),
            (lambda n, g: np.full((n, 2), np.nan), DomainError, "NaN"),
            (lambda n, g: None, DomainError, "The points of function"),
            (lambda n, g: [[0.5], [0.5, 0.5]], DomainError, "not an array of real numbers"),
        ],
    )
    def test_the_returned_points_are_checked(self, draw, error, words):
        source = mcs.Sampler.from_function(draw, dims=2)
        refused(error, words, source.draw, 4, rng=2)

    def test_bad_arguments(self):
        refused(ParameterError, "is not callable", mcs.Sampler.from_function, "draw", dims=2)
        refused(ParameterError, "dims is 0", mcs.Sampler.from_function, draw_uniform, dims=0)

    def test_errors_of_the_function_are_not_changed(self):
        source = mcs.Sampler.from_function(lambda n, g: 1 / 0, dims=2)
        with pytest.raises(ZeroDivisionError):
            source.draw(4)


class Tilted(qmc.QMCEngine):
    """An external engine with its own argument."""

    def __init__(self, d, *, tilt=0.25, rng=None):
        super().__init__(d=d, rng=rng)
        self._tilt = tilt

    def _random(self, n=1, *, workers=1):
        del workers
        return (self.rng.random((n, self.d)) + self._tilt) % 1.0


class Old(qmc.QMCEngine):
    """An engine written for the old argument `seed=`."""

    def __init__(self, d, seed=None):
        super().__init__(d=d, seed=seed)

    def _random(self, n=1, *, workers=1):
        del workers
        return self.rng.random((n, self.d))


class Forgetful(Tilted):
    """An engine that does not store its argument."""

    def __init__(self, d, *, secret=1, rng=None):
        super().__init__(d, rng=rng)
        del secret


class Open(Tilted):
    """An engine that accepts any argument."""

    def __init__(self, **anything):
        super().__init__(**anything)


class Fixed(Tilted):
    """An engine that accepts no generator."""

    def __init__(self, d=2):
        super().__init__(d, rng=0)


class Flat(Tilted):
    """An engine that is always in 3-D."""

    def __init__(self, rng=None):
        super().__init__(3, rng=rng)


ENGINES = [
    ("Sobol", 8),
    ("Halton", 7),
    ("LatinHypercube", 7),
    (qmc.Sobol, 8),
    (qmc.Halton(2, rng=1), 7),
    (qmc.LatinHypercube(2, strength=2), 9),
    (qmc.PoissonDisk(2, radius=0.05, ncandidates=10), 5),
    (Tilted(2, tilt=0.5), 7),
    (Tilted, 7),
    (Old, 7),
    (Old(2, seed=3), 7),
    (Open, 7),
    (lambda rng: qmc.Halton(2, rng=rng), 7),
]


def engine_name(engine):
    """Return a name without an address, equal in every process."""
    named = engine if isinstance(engine, str | int | type) else type(engine)
    return getattr(named, "__name__", str(named))


class TestScipySampler:
    """An engine is created for each realization."""

    @pytest.mark.parametrize(("engine", "n"), ENGINES, ids=engine_name)
    def test_realizations_are_reproducible_and_independent(self, engine, n):
        sizes = {"d": 2} if isinstance(engine, str | type) else {}
        source = mcs.Sampler.from_scipy(engine, **sizes)
        assert source.dims == 2
        whole = source.draw(n, realizations=5, rng=1)
        np.testing.assert_array_equal(source.draw(n, realizations=2, first=3, rng=1), whole[3:])
        assert len(np.unique(whole)) == whole.size
        assert not np.array_equal(source.draw(n, rng=2), whole[:1])

    def test_points_equal_those_of_the_engine(self):
        source = ScipySampler(engine="Sobol", scramble=False)
        expected = qmc.Sobol(2, scramble=False).random(8)
        np.testing.assert_array_equal(source.draw(8, rng=1)[0], expected)
        assert not source.unbiased
        stream = mcs.core.streams.Stream.from_rng(1)
        expected = qmc.Halton(2, rng=stream.generator(3)).random(7)
        np.testing.assert_array_equal(
            ScipySampler(engine="Halton").draw(7, rng=1, first=3)[0], expected
        )

    def test_arguments_of_an_instance_are_kept(self):
        source = mcs.Sampler.from_scipy(qmc.Sobol(3, scramble=False, bits=40))
        assert (source.dims, source.scramble, source.options["bits"]) == (3, False, 40)
        source = mcs.Sampler.from_scipy(qmc.LatinHypercube(2, scramble=False, strength=2))
        assert (source.scramble, source.options["strength"]) == (False, 2)
        source = mcs.Sampler.from_scipy(qmc.LatinHypercube(2, optimization="random-cd"))
        assert source.options["optimization"] == "random-cd"
        source = mcs.Sampler.from_scipy(qmc.PoissonDisk(2, radius=0.1, hypersphere="surface"))
        assert source.options["radius"] == 0.1
        assert source.options["hypersphere"] == "surface"
        assert mcs.Sampler.from_scipy(Tilted(2, tilt=0.5)).options == {"tilt": 0.5}

    def test_an_instance_is_not_advanced(self):
        engine = qmc.Halton(2, rng=1)
        mcs.Sampler.from_scipy(engine).draw(8, rng=1)
        assert engine.num_generated == 0

    def test_dims_may_be_the_engine_s_own(self):
        assert mcs.Sampler.from_scipy(Flat).dims == 3
        assert mcs.Sampler.from_scipy(lambda rng: qmc.Halton(4, rng=rng)).dims == 4
        assert mcs.Sampler.from_scipy(qmc.Sobol, dims=5).dims == 5

    @pytest.mark.parametrize(
        ("source", "spec"),
        [
            (ScipySampler(), "scipy"),
            (
                ScipySampler(engine="Halton", dims=3, scramble=True),
                "scipy(engine='Halton', scramble=True)",
            ),
            (
                ScipySampler(engine=qmc.LatinHypercube, options={"strength": 2}),
                "scipy(engine='LatinHypercube', options={'strength': 2})",
            ),
        ],
    )
    def test_spec_round_trip(self, source, spec):
        assert source.spec == spec
        assert sampler(spec, source.dims) == source
        assert hash(source) == hash(sampler(spec, source.dims))

    def test_the_spec_names_engines_that_it_cannot_rebuild(self):
        assert "Tilted" in mcs.Sampler.from_scipy(Tilted(2, tilt=0.5)).spec
        assert "'tilt': 0.5" in mcs.Sampler.from_scipy(Tilted(2, tilt=0.5)).spec

    @pytest.mark.parametrize(
        ("engine", "arguments", "unbiased"),
        [
            ("Sobol", {}, True),
            ("Halton", {"scramble": True}, True),
            ("LatinHypercube", {}, True),
            ("LatinHypercube", {"scramble": False}, False),
            ("LatinHypercube", {"options": {"optimization": "lloyd"}}, False),
            ("PoissonDisk", {}, False),
            (Tilted, {}, False),
        ],
    )
    def test_unbiased_is_declared_for_known_engines_only(self, engine, arguments, unbiased):
        assert ScipySampler(engine=engine, **arguments).unbiased == unbiased

    @pytest.mark.parametrize("engine", ["Sobol", "Halton", "LatinHypercube"])
    def test_scrambled_engines_are_uniform_across_realizations(self, engine):
        """χ² on 4×4 cells of point 3 of 500 realizations: generators are independent."""
        x = np.floor(4 * ScipySampler(engine=engine).draw(4, realizations=500, rng=4)[:, 3])
        counts = np.bincount((4 * x[:, 0] + x[:, 1]).astype(int), minlength=16)
        assert stats.chisquare(counts).pvalue > LEVEL

    @pytest.mark.parametrize(
        ("engine", "arguments", "words"),
        [
            ("Sobl", {}, "no engine 'Sobl'. Did you mean 'Sobol'"),
            ("QMCEngine", {}, "no engine 'QMCEngine'"),
            ("discrepancy", {}, "no engine 'discrepancy'"),
            (5, {}, "5 is not an engine"),
            (None, {}, "None is not an engine"),
            (int, {}, "is not an engine"),
            ("Sobol", {}, "needs its number of dims: give d="),
            ("Sobol", {"d": 0}, "d is 0"),
            ("Sobol", {"d": 2, "dims": 2}, "d and dims are the same"),
            ("Sobol", {"d": 2, "seed": 1}, "seed is not an option"),
            ("Sobol", {"d": 2, "rng": 1}, "rng is not an option"),
            ("Sobol", {"d": 2, "skramble": 1}, "Sobol cannot be made with d=2, skramble=1"),
            ("Sobol", {"d": 2, "scramble": "no"}, "scramble is 'no'"),
            ("Sobol", {"d": 30_000}, "Sobol cannot be made"),
            (qmc.Halton(2), {"d": 2}, "already has its arguments"),
            (Forgetful(2), {}, "does not store its argument secret"),
            (Open(d=2), {}, r"does not store its argument \*anything"),
            (Fixed, {}, "takes neither rng nor seed"),
            (lambda rng: qmc.Halton(2, rng=rng), {"scramble": True}, "takes no scramble"),
            (lambda rng: 5, {}, "returned 5; it must return a QMCEngine"),
        ],
    )
    def test_other_objects_than_engines_are_refused(self, engine, arguments, words):
        with pytest.raises(ParameterError, match=words) as caught:
            mcs.Sampler.from_scipy(engine, **arguments)
        assert "\n" not in str(caught.value)
        assert str(caught.value).endswith((".", "?"))

    def test_dims_that_an_engine_does_not_support(self):
        refused(ParameterError, "in 3 dims, not in 2", ScipySampler, engine=Flat, dims=2)
        refused(ParameterError, "options are 5", ScipySampler, options=5)
        refused(ParameterError, "d is not an option", ScipySampler, options={"d": 3})

    def test_counts_that_an_engine_does_not_support(self):
        few = mcs.Sampler.from_scipy(qmc.PoissonDisk(2, radius=0.3))
        refused(CountError, r"returned \d+ of 1000 points", few.draw, 1000, rng=1)
        square = mcs.Sampler.from_scipy("LatinHypercube", d=2, strength=2)
        refused(CountError, "cannot make 10 points", square.draw, 10, rng=1)

    def test_as_sampler_takes_engines(self):
        for engine in (qmc.Halton, qmc.Halton(2)):
            assert mcs.samplers.as_sampler(engine, 2).spec.startswith("scipy(engine='Halton'")


def test_scipy_stats_is_imported_only_for_engines():
    """The import takes half a second, which only users of engines should wait for."""
    code = (
        "import sys; from mcspectra.samplers import external, poisson, sampler; "
        "sampler('points(points=[[0.5]])').draw(1); print('scipy.stats' in sys.modules)"
    )
    done = python("-c", code, check=True)
    assert done.stdout.strip() == "False"


class TestRecognition:
    """Recognition of nets and lattices from their points alone."""

    @staticmethod
    def law(spec, dims, n, seed=1):
        points = mcs.sampler(spec, dims=dims).draw(n, rng=seed)[0]
        return mcs.Sampler.from_points(points).law(n)

    @pytest.mark.parametrize(
        ("spec", "dims", "n", "base"),
        [
            ("sobol", 2, 16, 2),
            ("sobol", 8, 256, 2),
            ("sobol | owen", 3, 256, 2),
            ("hammersley", 2, 64, 2),
            ("pmj02", 2, 64, 2),
            ("faure", 3, 81, 3),
            ("faure | owen", 5, 125, 5),
        ],
    )
    def test_nets(self, spec, dims, n, base):
        law = self.law(spec, dims, n)
        assert (law.bases, law.even) == ((base,) * dims, False)
        assert law.digital == (base == 2 and "owen" not in spec and spec != "pmj02")

    @pytest.mark.parametrize(
        ("spec", "dims", "n"),
        [
            ("rank1-lattice", 2, 256),
            ("korobov", 4, 1024),
            ("fibonacci", 2, 233),
            ("rank1-lattice | shift", 3, 128),
            ("regular", 2, 64),
        ],
    )
    def test_lattices(self, spec, dims, n):
        law = self.law(spec, dims, n)
        assert law.even
        assert bases_to_scramble([law]) is None
        assert (law.vector is not None) == ("shift" not in spec and spec != "regular")
        if law.vector is not None:
            points = np.arange(n)[:, None] * np.array(law.vector) % n
            drawn = np.rint(n * mcs.sampler(spec, dims=dims).draw(n)[0])
            assert {tuple(p) for p in points} == {tuple(p) for p in drawn}

    @pytest.mark.parametrize("n", [16, 64])
    @pytest.mark.parametrize(
        "spec",
        ["random", "poisson-disk", "latin-hypercube", "bnot(sets=40)", "kronecker", "halton"],
    )
    def test_other_sets_are_neither(self, spec, n):
        many = mcs.sampler(spec, dims=2).draw(n, realizations=40, rng=1)
        laws = [mcs.Sampler.from_points(points).law(n) for points in many]
        assert not any(law.bases or law.even for law in laws)

    def test_small_sets_of_a_sequence_follow_the_largest(self):
        """16 points of Sobol' in 8 dims fill only halves evenly, as many other sets do."""
        sets = {n: mcs.sampler("sobol", dims=8).draw(n)[0] for n in (16, 64, 256, 1024)}
        both = mcs.samplers.GivenPoints.from_sets(sets.values(), "both")
        assert all(both.law(n).bases == (2,) * 8 for n in sets)
        assert mcs.Sampler.from_points(sets[16]).law(16).bases is None
        sets[64] = np.random.default_rng(1).random((64, 8))
        mixed = mcs.samplers.GivenPoints.from_sets(sets.values(), "mixed")
        assert mixed.law(64).bases is None
        assert bases_to_scramble([mixed.law(n) for n in sets]) is None

    def test_digits_are_scrambled_in_the_base_of_the_net(self):
        """Nets in base 3 were once scrambled in base 2, which breaks them."""
        source = mcs.Sampler.from_points(mcs.sampler("faure", dims=3).draw(81)[0])
        scrambled = source.then(Owen()).draw(81, realizations=3, rng=1)
        assert all(net_t_value(points, 3) == 0 for points in scrambled)

    def test_predictions_follow_the_recognized_set(self):
        f = mcs.integrand("genz-gaussian(a=3.5)", dims=2)
        for spec, step, n in (("sobol", "owen", 256), ("rank1-lattice", "shift", 128)):
            plain = mcs.sampler(spec, dims=2)
            given = mcs.Sampler.from_points(plain.draw(n)[0])
            step = mcs.samplers.RANDOMIZATIONS.load(step)()
            expected = mcs.predict(f, plain.then(step), [n])["predicted_variance"]
            found = mcs.predict(f, given.then(step), [n])["predicted_variance"]
            np.testing.assert_allclose(found, expected, rtol=1e-9)
