"""The checks for analyses: those of the package pass them, and each finds what is wrong."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Annotated, ClassVar

import msgspec
import numpy as np
import pytest
from msgspec import Meta

from mcspectra.core.analysis import ANALYSES, Analysis, Need, Reduction
from mcspectra.core.options import COUNT, REALIZATIONS
from mcspectra.core.records import JOIN, SUM
from mcspectra.core.results import Variable, dataset
from mcspectra.testing import BrokenContract, check_analysis

MANY = {"realizations": 45}
# options that are quick to compute, and what they are tried on
QUICK = {
    "convergence": ({"counts": (4, 16), "realizations": 700}, "gaussian", "jittered"),
    "terms": ({"n": 16, "half_width": 2, **MANY}, "gaussian", "jittered"),
    "techniques": ({"counts": 16, "half_width": 2, **MANY}, "gaussian", "jittered"),
    "spectrum": ({"n": 16, "half_width": 2, **MANY}, None, "jittered"),
    "points": ({"n": 16}, None, "jittered"),
    "pcf": ({"n": 16, "bins": 8, "realizations": 9}, None, "jittered"),
    "anova": ({"n": 9, **MANY}, "gaussian", "jittered"),
    "anova-spectrum": ({"n": 8, "frequencies": 32}, "gaussian", "random"),
    "exact": ({"counts": (4, 16)}, "gaussian", "jittered"),
    "remedies": (
        {"budget": 64, "realizations": 100, "kinds": ("sampler",)},
        "gaussian(center=0.3, width=0.3, dims=1)",
        "jittered",
    ),
    "modes": ({"n": 16, "half_width": 2, "modes": 2, **MANY}, "gaussian", "jittered"),
    "routes": ({"n": 16, "half_width": 2, **MANY}, "gaussian", "jittered | shift"),
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


def test_every_analysis_is_tried():
    assert set(QUICK) == set(ANALYSES)


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=pytest.mark.render) if n == "map" else n for n in QUICK]
)
def test_analyses_of_the_package_keep_the_contract(name):
    options, estimator, sampler = QUICK[name]
    check_analysis(ANALYSES.load(name)(**options), estimator, sampler)


@dataclass
class Estimates:
    values: JOIN
    total: SUM


@dataclass
class Values:
    """Less than blocks give."""

    values: JOIN


@dataclass
class Bare:
    """Without a rule."""

    values: np.ndarray


class Means(Analysis, frozen=True, kw_only=True):
    """Mean of the estimates."""

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


class NoMeaning(Means, frozen=True, kw_only=True):
    """An option says nothing."""

    order: int = 1


class OddDefault(Means, frozen=True, kw_only=True):
    """A default is out of its limits."""

    order: Annotated[int, Meta(ge=2, description="An order.")] = 1


class NoSummary(Means, frozen=True, kw_only=True):
    __doc__ = ""


class SlowNeed(Means, frozen=True, kw_only=True):
    """It computes to say what it needs."""

    def need(self, subject):
        end = time.process_time() + 0.15
        while time.process_time() < end:
            pass
        return Need()


class EndlessNeed(Means, frozen=True, kw_only=True):
    """It would never end."""

    def need(self, subject):
        return Need(cost=float("inf"))


class FailingNeed(Means, frozen=True, kw_only=True):
    """It refuses with an error of its own."""

    def need(self, subject):
        raise KeyError("dims")


class Lost(Means, frozen=True, kw_only=True):
    """The kind of its states has fewer fields than they have."""

    def reduction(self, subject, stream):
        found = super().reduction(subject, stream)
        return Reduction(kind=Values, block=found.block, blocks=found.blocks, result=found.result)


class Objects(Means, frozen=True, kw_only=True):
    """Its states are functions."""

    def reduction(self, subject, stream):
        return Reduction(kind=Bare, block=lambda _: Bare([print]), result=lambda _: dataset({}))


class NoRule(Means, frozen=True, kw_only=True):
    """Its states do not say how they merge."""

    def reduction(self, subject, stream):
        return Reduction(
            kind=Bare, block=lambda _: Bare(np.ones(1)), blocks=2, result=lambda _: dataset({})
        )


class FailingBlock(Means, frozen=True, kw_only=True):
    """A block raises."""

    def values(self, subject, stream, index):
        return subject.estimator.estimate(index)


SEEN: list[int] = []


class Remembers(Means, frozen=True, kw_only=True):
    """What was computed before matters."""

    def values(self, subject, stream, index):
        SEEN.append(index)
        return np.full(1, float(len(SEEN)))


class Undeclared(Means, frozen=True, kw_only=True):
    """Its result has a variable that it does not declare."""

    variables: ClassVar = ("mean",)


class OtherDims(Means, frozen=True, kw_only=True):
    """A variable has other dims."""

    variables: ClassVar = ("mean", Variable("sum of squares", "f²", ("n",), name="power"))


class Later(Means, frozen=True, kw_only=True):
    """`part` knows nothing of its second step."""

    def reduction(self, subject, stream):
        found = super().reduction(subject, stream)
        yield [found]
        (state,) = yield [
            Reduction(kind=found.kind, block=found.block, blocks=found.blocks, key="later")
        ]
        return found.result(state)


class Named(Means, frozen=True, kw_only=True):
    """An option has a name of its verb."""

    seed: Annotated[int, Meta(description="A seed.")] = 1


class Flagged(Means, frozen=True, kw_only=True):
    """An option has a flag of its verb."""

    order: Annotated[int, Meta(description="An order.", extra={"flag": "-o"})] = 1


class Hidden(Means, frozen=True, kw_only=True):
    """Two options have one flag."""

    sort: Annotated[bool, Meta(description="Sort.")] = True
    no_sort: Annotated[int, Meta(description="What else.")] = 1


class NoValues(Means, frozen=True, kw_only=True):
    """A default that msgspec makes each time is out of its limits."""

    counts: Annotated[tuple[int, ...], Meta(description="Counts.")] = msgspec.field(
        default_factory=tuple
    )


FAULTS = {
    Named: "has the option 'seed', but that name is taken",
    Flagged: "has the option 'order', but the flag -o is taken",
    Hidden: "has the option 'no_sort', but the flag --no-sort is taken",
    NoValues: "fails in the default of counts: ParameterError: counts has no values",
    NoMeaning: "has the option order without a meaning",
    OddDefault: "fails in the default of order: ParameterError: order is 1; give .* at least 2",
    NoSummary: "has no docstring",
    SlowNeed: r"takes 0\.\d+ s in need",
    EndlessNeed: "returns .* from need, which is not finite",
    FailingNeed: "fails in need: KeyError: 'dims'",
    Lost: "has a state that changes when it is stored",
    Objects: "fails in a state as bytes: TypeError",
    NoRule: "fails in merging states: TypeError: A ndarray has no rule to merge",
    FailingBlock: "fails in block",
    Remembers: "gives different results in chunks, or for the same seed",
    Undeclared: "fails in its variables: AnalysisError: .*'power', which it does not declare",
    OtherDims: r"fails in its variables: AnalysisError: .*power has the dims \[\]",
    Later: "fails in part",
}


@pytest.mark.parametrize("fault", FAULTS, ids=lambda each: each.__name__)
def test_faults_are_found(fault):
    with pytest.raises(BrokenContract, match=f"^{fault.__name__} {FAULTS[fault]}"):
        check_analysis(fault())


def test_options_out_of_their_limits_are_found():
    with pytest.raises(BrokenContract, match="^Means fails in its options: ParameterError: n is 0"):
        check_analysis(Means(n=0))
