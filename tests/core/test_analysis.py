"""Analyses: their functions in Python, and the same merge tree for any chunks and threads."""

import inspect
import random
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import Annotated, ClassVar

import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec import Meta

import mcspectra as mcs
from mcspectra.core.analysis import (
    ANALYSES,
    Analysis,
    MergeTree,
    Need,
    Reduction,
    Subject,
    chunks,
    compute,
    compute_chunk,
    finished,
    in_step,
    whole,
)
from mcspectra.core.errors import (
    AnalysisError,
    ConfigError,
    MissingDependency,
    ParameterError,
)
from mcspectra.core.options import options_of
from mcspectra.core.progress import listening
from mcspectra.core.records import MeanSums
from mcspectra.core.results import Variable, check_variables, dataset
from mcspectra.core.streams import Stream
from mcspectra.estimators import as_subject


def _with_functions():
    """All analyses that load and have a function in Python."""
    for name in ANALYSES:
        try:
            found = ANALYSES.load(name)
        except MissingDependency:
            continue
        if found.function:
            yield name, found


CASES = dict(_with_functions())


@pytest.mark.parametrize("name", CASES)
def test_functions_have_the_options_with_their_defaults(name):
    analysis = CASES[name]
    parameters = inspect.signature(attrgetter(analysis.function)(mcs)).parameters
    options = {
        option.name: inspect.Parameter.empty if option.required else option.default
        for option in options_of(analysis)
    }
    assert options.keys() <= parameters.keys()
    assert {key: parameters[key].default for key in options} == options


# --- merge tree ---------------------------------------------------------------------------------
# ---------------------------------------------------------------------------------


@dataclass
class Words:
    """A state that records how it was merged; reuses its left states."""

    said: list[str]

    def merge(self, other):
        self.said[0] = f"({self.said[0]}{other.said[0]})"
        return self


@dataclass
class Skewed:
    """A merge of floats that is neither associative nor commutative."""

    value: float

    def merge(self, other):
        return Skewed(self.value + 0.7 * other.value)


def _tree(states):
    tree = MergeTree()
    for state in states:
        tree.add(state)
    return tree.total()


def _names(blocks):
    return [f"{i}," for i in range(blocks)]


def _by_definition(names):
    """Recursive definition of the tree: the left subtree has the largest power of two of blocks."""
    if len(names) == 1:
        return names[0]
    half = 1 << ((len(names) - 1).bit_length() - 1)
    return f"({_by_definition(names[:half])}{_by_definition(names[half:])})"


@settings(deadline=None)
@given(st.integers(1, 200))
def test_the_tree_is_the_left_balanced_one(blocks):
    assert _tree(Words([name]) for name in _names(blocks)).said == [_by_definition(_names(blocks))]


@settings(deadline=None)
@given(st.integers(1, 150), st.integers(0, 8))
def test_chunks_of_equal_size_do_not_change_the_tree(blocks, power):
    computed = []

    def block(index):
        computed.append(index)
        return Words([f"{index},"])

    found, tree = Reduction(kind=Words, block=block, blocks=blocks), MergeTree()
    for chunk in chunks(blocks, 2**power):
        tree.add(compute_chunk(found, chunk), chunk[1])
    assert computed == list(range(blocks))
    assert tree.total().said == [_by_definition(_names(blocks))]


def _mixed(blocks, choose):
    """Chunks of mixed sizes: any power of two that divides the first block, and shorter ends."""
    first = 0
    while first < blocks:
        sizes = [2**k for k in range(9) if first % 2**k == 0]
        size = min(choose(sizes), blocks - first)
        yield first, size
        first += size


@settings(deadline=None)
@given(st.integers(1, 150), st.integers(0, 2**32))
def test_chunks_of_mixed_sizes_do_not_change_the_tree(blocks, seed):
    choose = random.Random(seed).choice
    values = [0.1 * (i + 1) ** 0.5 for i in range(blocks)]
    tree, said = MergeTree(), MergeTree()
    for first, size in _mixed(blocks, choose):
        own = range(first, first + size)
        tree.add(_tree(Skewed(values[i]) for i in own), size)
        said.add(_tree(Words([f"{i},"]) for i in own), size)
    assert tree.total() == _tree(map(Skewed, values))
    assert said.total().said == [_by_definition(_names(blocks))]


def test_a_tree_holds_few_states():
    tree = MergeTree()
    for i in range(1000):
        tree.add(Skewed(float(i)))
        assert len(tree.nodes) <= 10  # ⌊log₂ 1000⌋ + 1


# --- steps
# ------------------------------------------------------------------------------------------


def _counting(part, steps):
    total = 0
    for step in range(steps):
        total += yield Reduction(kind=int, block=int, key=f"{part}-{step}")
    return part, total


def _drive(generator, answer):
    """Steps of a generator of reductions, and its return value."""
    steps, states = [], None
    try:
        while True:
            steps.append(generator.send(states))
            states = [answer(each) for each in steps[-1]]
    except StopIteration as end:
        return steps, end.value


def test_generators_go_in_step():
    together = in_step([_counting(p, s) for p, s in enumerate([2, 0, 3, 1])])
    steps, results = _drive(together, lambda each: 10 ** int(each.key[2:]))
    assert results == [(0, 11), (1, 0), (2, 111), (3, 1)]
    found = [[each.key for each in step] for step in steps]
    assert found == [["0-0", "2-0", "3-0"], ["0-1", "2-1"], ["2-2"]]


SUBJECT = Subject(None, mcs.sampler("random", dims=2))


class Said(Analysis, frozen=True, kw_only=True):
    """Words of all blocks, in two steps of two reductions."""

    variables: ClassVar = (Variable("blocks of both steps", "1", ("step",), "i", name="blocks"),)

    blocks: Annotated[int, Meta(ge=1, le=100, description="Blocks of a reduction.")] = 9
    memory: Annotated[int, Meta(ge=0, description="Bytes that it needs.")] = 0

    def need(self, subject):
        if subject.sampler.dims > 2:
            raise ParameterError("Only two dims.")
        return Need(cost=4.0 * self.blocks, memory=self.memory)

    def reduction(self, subject, stream):
        texts = []
        for step in "ab":
            states = yield [self._words(f"{step}{k}") for k in (0, 1)]
            texts.append("|".join(state.said[0] for state in states))
        return dataset({}, words=";".join(texts)).assign(blocks=("step", [self.blocks] * 2))

    def _words(self, key):
        def block(index):
            return Words([f"{key}{index},"])

        return Reduction(kind=Words, block=block, blocks=self.blocks, key=key)


@pytest.mark.parametrize("workers", [None, 1, 2, 5])
def test_threads_do_not_change_results(workers):
    found = compute(Said(), SUBJECT, rng=4, workers=workers)
    one, two = (
        "|".join(_by_definition([f"{step}{k}{i}," for i in range(9)]) for k in (0, 1))
        for step in "ab"
    )
    assert found.attrs["words"] == f"{one};{two}"
    assert (found["blocks"].values.tolist(), found.attrs["seed"]) == ([9, 9], 4)


def test_progress_grows_to_the_end_in_every_step():
    heard = []
    with listening(lambda *each: heard.append(each)):
        compute(Said(blocks=4), SUBJECT)
    assert {name for name, _ in heard} == {"Said"}
    assert [done for _, done in heard] == [k / 8 for k in range(1, 9)] * 2


def test_an_error_in_a_block_is_raised_from_threads():
    class Fails(Analysis, frozen=True, kw_only=True):
        """An analysis that fails."""

        def reduction(self, subject, stream):
            def block(index):
                if index == 3:
                    raise ValueError("no such integrand")
                return Skewed(1.0)

            return Reduction(kind=Skewed, block=block, blocks=9, result=lambda _: _small())

    for workers in (1, 2):
        with pytest.raises(ValueError, match="no such integrand"):
            compute(Fails(), SUBJECT, workers=workers)


def test_options_then_the_subject_are_checked_before_anything_runs():
    with pytest.raises(ParameterError, match="blocks is 0"):
        compute(Said(blocks=0), Subject(None, mcs.sampler("random", dims=3)))
    with pytest.raises(ParameterError, match="Only two dims"):
        compute(Said(), Subject(None, mcs.sampler("random", dims=3)))
    for workers in (0, -1, 2.5, "two"):
        with pytest.raises(ParameterError, match="workers"):
            compute(Said(), SUBJECT, workers=workers)
    with pytest.raises(ParameterError):
        compute(Said(), SUBJECT, rng="nonsense")


def test_too_much_memory_is_an_error(monkeypatch):
    with pytest.raises(ConfigError, match=r"Said would take about 1e\+03 PB of memory"):
        compute(Said(memory=10**18), SUBJECT)
    monkeypatch.setattr("mcspectra.core.memory.available_memory", lambda: 10**6)
    compute(Said(memory=10**6), SUBJECT)
    with pytest.raises(ConfigError, match="this machine has 1 MB; ask for fewer"):
        compute(Said(memory=10**6 + 1), SUBJECT)


# --- indivisible computations and results
# -------------------------------------------------------------


def _small():
    return dataset({"variance": (("n",), np.ones(2))}, {"n": [4, 16]}, seed=1)


def test_the_state_of_an_indivisible_computation_is_its_dataset():
    class Whole(Analysis, frozen=True, kw_only=True):
        """A computation in one piece."""

        variables: ClassVar = ("variance",)

        def reduction(self, subject, stream):
            return whole(_small)

    found = Whole().reduction(SUBJECT, Stream.from_rng(0))
    assert found.blocks == 1
    xr.testing.assert_identical(compute(Whole(), SUBJECT, rng=1, workers=2), _small())


def test_the_seed_is_an_attribute_of_a_reproducible_result():
    class Variances(Said, frozen=True, kw_only=True):
        """Variances."""

        variables: ClassVar = ("variance",)

    unseeded = _small().drop_attrs()
    for rng, seed in ((7, 7), (np.int64(7), 7), (2**64, str(2**64))):
        assert finished(Variances(), unseeded, rng).attrs == {"seed": seed}
    for rng in (np.random.default_rng(3), None):
        assert finished(Variances(), unseeded, rng).attrs == {}
    with pytest.raises(TypeError, match="Said gives the variable 'variance'.*not declare"):
        finished(Said(), _small(), 0)


@pytest.mark.parametrize(
    ("variable", "words"),
    [
        ({"variance": ("n", np.ones(2, int))}, "variance holds int64, but 'f' is declared"),
        ({"variance": (("x", "n"), np.ones((1, 2)))}, r"has the dims \['x', 'n'\]"),
        ({"rate": ("n", np.ones(2))}, r"has the dims \['n'\]"),
        ({"mean": ("n", np.ones(2))}, "which it does not declare"),
    ],
)
def test_results_are_compared_with_declared_variables(variable, words):
    declared = ("variance", "rate", Variable("its own", "1", ("m", "k?"), "if", name="own"))
    with pytest.raises(TypeError, match=words):
        check_variables(xr.Dataset(variable), declared, "An analysis")
    for dims in (("m0", "m1"), ("m0", "k"), ("k",), ("channel", "m0"), ()):
        own = xr.Dataset({"own": (dims, np.ones((2,) * len(dims), int))})
        check_variables(own, declared, "An analysis")
    for dims in (("k", "m0"), ("m0", "k", "k2"), ("l0",)):
        with pytest.raises(TypeError, match="own has the dims"):
            check_variables(xr.Dataset({"own": (dims, np.ones((2,) * len(dims)))}), declared, "It")


def test_a_result_records_its_provenance():
    class Of(Said, frozen=True, kw_only=True):
        """An analysis with provenance."""

        provenance: ClassVar = ("estimator", "sampler", "blocks", "stream_key")

    found = compute(Of.of({"blocks": 3, "memory": 0, "rng": 5}), SUBJECT, rng=5).attrs
    key = Stream.from_rng(5).key
    assert {name: found.get(name) for name in (*Of.provenance, "seed")} == {
        "estimator": None,
        "sampler": "random",
        "blocks": 3,
        "stream_key": f"{key:#x}",
        "seed": 5,
    }
    with pytest.raises(KeyError, match="memory"):
        Of.of({"blocks": 3})


def _sum_of(key="0", result=lambda total: _small()):
    return Reduction(kind=MeanSums, block=lambda i: MeanSums.zeros(1), key=key, result=result)


def _blocks(number):
    return replace(_sum_of(), blocks=number)


def _two_of_one_key():
    yield [_sum_of("a"), _sum_of("a")]


def _no_list():
    yield _sum_of()


@pytest.mark.parametrize(
    ("need", "reduction", "words"),
    [
        (3.0, _sum_of, "Odd needs 3.0; its need must return a Need"),
        (Need(), lambda: None, "Odd is computed by None; its reduction must return a Reduction"),
        (Need(), lambda: [_sum_of()], "or be a generator that yields lists of them"),
        (Need(), lambda: _sum_of(result=None), "Odd has a Reduction without result"),
        (Need(), lambda: _sum_of(result=lambda total: None), "Odd gives None as its result"),
        (
            Need(),
            _two_of_one_key,
            "Odd has two reductions of the key 'a'; give each a key of its own",
        ),
        (Need(), lambda: Analysis().reduction(SUBJECT, None), "Analysis has no reduction; define"),
        (Need(), lambda: _blocks(0), "Odd has a reduction of 0 blocks; give a whole number from 1"),
        (Need(), lambda: _blocks(1.5), "Odd has a reduction of 1.5 blocks"),
        (Need(), _no_list, "Odd has the step Reduction.*; give a list of Reductions"),
    ],
)
def test_an_analysis_that_breaks_its_contract_is_named(need, reduction, words):
    class Odd(Analysis, frozen=True, kw_only=True):
        """An analysis that breaks its contract."""

        variables: ClassVar = ("variance",)

        def need(self, subject):
            return need

        def reduction(self, subject, stream):
            return reduction()

    with pytest.raises(AnalysisError, match=words):
        compute(Odd(), SUBJECT)


# --- the registry
# -----------------------------------------------------------------------------------


def test_an_unknown_key_raises_with_advice():
    with pytest.raises(NotImplementedError, match="no reduction with the key 'x'.*override part"):
        CASES["anova"](n=1).part(as_subject("gaussian", "random"), Stream.from_rng(0), "x")
