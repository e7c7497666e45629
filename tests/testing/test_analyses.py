"""Checks for analyses: the package's own analyses pass, and faults are found."""

import time
from dataclasses import dataclass, replace
from typing import Annotated, ClassVar

import msgspec
import numpy as np
import pytest
from msgspec import Meta

import mcspectra as mcs
from mcspectra.core.analysis import ANALYSES, Analysis, Need, Reduction
from mcspectra.core.options import COUNT, REALIZATIONS
from mcspectra.core.records import JOIN, SUM
from mcspectra.core.results import Variable, dataset
from mcspectra.testing import BrokenContract, check_analysis

MANY = {"realizations": 45}
# Options that are quick to compute, with an integrand and a sampler for the check
QUICK = {
    "convergence": ({"counts": (4, 16), "realizations": 700}, "gaussian", "jittered"),
    "terms": ({"n": 16, "half_width": 2, **MANY}, "gaussian", "jittered"),
    "techniques": (
        {"counts": (4, 16), "half_width": 2, **MANY},
        mcs.MultipleImportance("gaussian", ["linear", "uniform"], dims=1),
        "jittered",
    ),
    "spectrum": ({"n": 16, "half_width": 2, **MANY}, None, "jittered"),
    "points": ({"n": 16}, None, "jittered"),
    "pcf": ({"n": 16, "bins": 8, "realizations": 9}, None, "jittered"),
    "anova": ({"n": 9, **MANY}, "gaussian", "jittered"),
    "anova-spectrum": ({"n": 8, "frequencies": 32}, "gaussian", "random"),
    "predict": ({"counts": (4, 16)}, "gaussian", "jittered"),
    "plan": ({"target_error": 0.02}, "gaussian", "jittered"),
    "profile": ({"budget": 1024}, "gaussian", "random"),
    "remedies": (
        {"budget": 64, "realizations": 100, "kinds": ("sampler",)},
        "gaussian(center=0.3, width=0.3, dims=1)",
        "jittered",
    ),
    "modes": ({"n": 16, "half_width": 2, "modes": 2, **MANY}, "gaussian", "jittered"),
    "map": (
        {
            "scene": "penumbra",
            "counts": (4, 16),
            "realizations": 8,
            "size": (8, 6),
            "predict_every": 2,
        },
        None,
        "jittered",
    ),
}


def test_every_analysis_is_checked():
    assert set(QUICK) == set(ANALYSES)


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=pytest.mark.render) if n == "map" else n for n in QUICK]
)
def test_analyses_of_the_package_fulfill_the_contract(name):
    options, estimator, sampler = QUICK[name]
    check_analysis(ANALYSES.load(name)(**options), estimator, sampler)


@dataclass
class Estimates:
    values: JOIN
    total: SUM


@dataclass
class Values:
    """A state with fewer fields than the blocks return."""

    values: JOIN


@dataclass
class Bare:
    """A state without a rule for merging."""

    values: np.ndarray


class Means(Analysis, frozen=True, kw_only=True):
    """Analysis that returns the mean of the estimates."""

    variables: ClassVar = ("mean", Variable("sum of squares", "f²", (), name="power"))

    n: Annotated[int, COUNT] = 4
    realizations: Annotated[int, REALIZATIONS] = 9

    def need(self, subject):
        return Need(cost=float(self.n * self.realizations), memory=2**20)

    def values(self, subject, stream, index):
        points = subject.sampler.draw_stream(self.n, stream, index, 1)
        return subject.estimator.estimate([points])

    def reduction(self, subject, stream):
        def block(index):
            values = self.values(subject, stream, index)
            return Estimates(values, (values**2).sum(axis=0, keepdims=True))

        def result(state):
            total = float(np.sum(state.total))
            return dataset({"mean": ((), state.values.mean())}, n=self.n).assign(power=total)

        return Reduction(kind=Estimates, block=block, blocks=self.realizations, result=result)


def test_a_sound_analysis_passes():
    check_analysis(Means())
    check_analysis(Means(n=8), "linear", "sobol | owen")


def slow(analysis, subject):
    end = time.process_time() + 0.15
    while time.process_time() < end:
        pass
    return Need()


def failing(analysis, subject):
    raise KeyError("dims")


def lost(analysis, subject, stream):
    """Return a reduction whose kind of state lacks fields."""
    return replace(Means.reduction(analysis, subject, stream), kind=Values)


def bare(values, blocks=1):
    """Return a reduction whose states cannot be merged."""

    def reduction(analysis, subject, stream):
        return Reduction(
            kind=Bare, block=lambda _: Bare(values), blocks=blocks, result=lambda _: dataset({})
        )

    return reduction


def later(analysis, subject, stream):
    """Return steps of which `part` finds only the first."""
    found = Means.reduction(analysis, subject, stream)
    yield [found]
    (state,) = yield [replace(found, key="later", result=None)]
    return found.result(state)


SEEN: list[int] = []


def remembers(analysis, subject, stream, index):
    SEEN.append(index)
    return np.full(1, float(len(SEEN)))


def option(kind, default, name="order", **extra):
    """Return a field with a description."""
    return name, Annotated[kind, Meta(description="What.", **extra)], default


POWER = Variable("sum of squares", "f²", ("n",), name="power")
# Fields and members that make a sound analysis faulty, and the expected message
FAULTS = {
    "a name of its verb": (
        [option(int, 1, "seed")],
        {},
        "has the option 'seed', but that name is taken",
    ),
    "a flag of its verb": (
        [option(int, 1, extra={"flag": "-o"})],
        {},
        "has the option 'order', but the flag -o is taken",
    ),
    "two options of one flag": (
        [option(bool, True, "sort"), option(int, 1, "no_sort")],
        {},
        "has the option 'no_sort', but the flag --no-sort is taken",
    ),
    "a made default out of its limits": (
        [option(tuple[int, ...], msgspec.field(default_factory=tuple), "counts")],
        {},
        "fails in the default of counts: ParameterError: counts has no values",
    ),
    "no meaning": ([("order", int, 1)], {}, "has the option order without a meaning"),
    "a default out of its limits": (
        [option(int, 1, ge=2)],
        {},
        "fails in the default of order: ParameterError: order is 1; give .* at least 2",
    ),
    "no summary": ([], {"__doc__": ""}, "has no docstring"),
    "slow need": ([], {"need": slow}, r"takes 0\.\d+ s in need"),
    "endless need": (
        [],
        {"need": lambda *_: Need(cost=float("inf"))},
        "returns .* from need, which is not finite",
    ),
    "failing need": ([], {"need": failing}, "fails in need: KeyError: 'dims'"),
    "a lost field": ([], {"reduction": lost}, "has a state that changes when it is stored"),
    "objects": ([], {"reduction": bare([print])}, "fails in a state as bytes: TypeError"),
    "no rule": (
        [],
        {"reduction": bare(np.ones(1), 2)},
        "fails in merging states: TypeError: A ndarray has no merge rule",
    ),
    "failing block": ([], {"values": lambda *_: [].pop()}, "fails in block"),
    "memory": (
        [],
        {"values": remembers},
        "gives different results in chunks, or for the same seed",
    ),
    "undeclared": (
        [],
        {"variables": ("mean",)},
        "fails in its variables: AnalysisError: .*'power', which it does not declare",
    ),
    "other dims": (
        [],
        {"variables": ("mean", POWER)},
        r"fails in its variables: AnalysisError: .*power has the dims \[\]",
    ),
    "a later step": ([], {"reduction": later}, "fails in part"),
}


@pytest.mark.parametrize(("fields", "members", "words"), FAULTS.values(), ids=FAULTS)
def test_faults_are_found(fields, members, words):
    named = {"__doc__": "It is broken.", **members}
    kind = msgspec.defstruct(
        "Broken", fields, bases=(Means,), namespace=named, frozen=True, kw_only=True
    )
    with pytest.raises(BrokenContract, match=f"^Broken {words}"):
        check_analysis(kind())


def test_options_outside_their_limits_are_found():
    with pytest.raises(BrokenContract, match="^Means fails in its options: ParameterError: n is 0"):
        check_analysis(Means(n=0))
