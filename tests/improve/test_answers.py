"""Sentences of an answer, made from given results."""

import pytest

from mcspectra.improve.answers import Answer, CandidateResult


def result(name, rmse, gain, verdict, ends):
    return CandidateResult(
        name, f"use {name}", ("f", name), 64, rmse, ends, gain=gain, verdict=verdict
    )


@pytest.mark.parametrize(("gain", "said"), [(1.1, True), (3.0, False)])
def test_a_small_gain_mentions_a_change_that_may_be_far_better(gain, said):
    """A large gain is advised alone: a change that is not certain would distract from it."""
    given = result("random", 0.2, 1.0, "given", (0.1, 0.3))
    small = result("latin-hypercube", 0.19, gain, "better", (0.1, 0.25))
    open_ = result("sobol | owen", 0.05, 16.0, "undecided", (0.01, 0.4))
    text = Answer.of(64, [given, small, open_]).advice
    assert text.startswith("Use latin-hypercube: RMSE 0.19 (0.1 to 0.25) at 64 evaluations")
    assert ("With sobol | owen the RMSE may be 0.05 (0.01 to 0.4)" in text) == said
