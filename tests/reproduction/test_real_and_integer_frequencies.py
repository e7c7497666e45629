"""Sums over real and integer frequencies: closed forms, and wrong inputs that must disagree."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.integrate import quad
from tests.reproduction.conftest import Disagreeing

from mcspectra.reproduction import real_and_integer_frequencies as frequencies
from mcspectra.reproduction.claims import Exhibit, judge
from mcspectra.reproduction.gallery import make_exhibit


def test_all_findings_agree(sound: Callable[[Exhibit], None]) -> None:
    """The expected rates are those of the slides."""
    made = make_exhibit("real-and-integer-frequencies", quick=True, seed=1)[0]
    sound(made)
    assert [f.expected.split()[0] for f in made.findings[5:9]] == ["−2.0", "−3.0", "−1.0", "−1.0"]


def test_exact_variances_of_the_ramp() -> None:
    n = np.array(frequencies.COUNTS, dtype=float)
    shifted = 1 / (6 * n**2) - 1 / (12 * n**3)
    np.testing.assert_allclose(frequencies.exact_variances("f", "jittered"), shifted, rtol=1e-9)
    np.testing.assert_allclose(frequencies.exact_variances("g", "random"), 1 / (8 * n), rtol=1e-9)


def test_limits_of_real_sums() -> None:
    assert frequencies.real_limit("f") == pytest.approx(7 / 120, rel=1e-12)
    # g ⋆ box by hand is G = t/2 − sin(2πt)/(4π) and its mirror image
    g = quad(lambda t: (t / 2 - np.sin(2 * np.pi * t) / (4 * np.pi)) ** 2, 0, 1)[0]
    assert frequencies.real_limit("g") == pytest.approx(2 * g - 1 / 8, rel=1e-9)


@pytest.mark.parametrize("name", frequencies.NAMES)
@pytest.mark.parametrize("nu", [0.5, 1.0, 2.5, 7.0])
def test_transforms_by_quadrature(name: str, nu: float) -> None:
    def f(x: float) -> float:
        return x if name == "f" else (1 - np.cos(2 * np.pi * x)) / 2

    real = quad(lambda x: f(x) * np.cos(2 * np.pi * nu * x), 0, 1)[0]
    imaginary = -quad(lambda x: f(x) * np.sin(2 * np.pi * nu * x), 0, 1)[0]
    found = complex(frequencies.transform(name, np.array([nu]))[0])
    assert found == pytest.approx(complex(real, imaginary), abs=1e-12)


def test_a_wrong_rate_disagrees(disagreeing: Disagreeing) -> None:
    curves, right = frequencies.measured(500, 1), frequencies.exact_variances
    other = {"f": "g", "g": "f"}
    found = disagreeing(
        frequencies,
        measured=lambda *_: curves,
        RATES={"f": -3.0, "g": -2.0},
        exact_variances=lambda name, sampler: right(other[name], sampler),
    )
    assert {5, 6, 1, 3} <= set(found)


def test_integers_have_a_rate(monkeypatch: pytest.MonkeyPatch) -> None:
    """Sums over integers do not pass the test for real frequencies."""
    right = frequencies.frequency_sums
    monkeypatch.setattr(frequencies, "frequency_sums", lambda f, s, step: right(f, s, 1.0))
    assert judge(frequencies._real_rate("f", "jittered")).agrees is False
    assert judge(frequencies._real_level("f")).agrees is False
