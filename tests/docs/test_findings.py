"""The pages on findings: links, pictures, quoted numbers, and the statements themselves."""

import re
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import mcspectra as mcs

FOLDER = Path(__file__).parents[2] / "docs" / "findings"
PAGES = sorted(page.name for page in FOLDER.glob("*.md") if page.name != "index.md")
FENCE = re.compile(r"^```.*?^```", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\]\(([^)#]+)\)")
# Decimals, signed and long numbers are measured. Small counts, dims and exponents are not.
NUMBER = re.compile(r"(?<![\w.])(?:-\d+(?:\.\d+)?|\d+\.\d+|\d{4,})(?:e[-+]\d+)?(?![\w.]*\d)")


def _text(name):
    return (FOLDER / name).read_text(encoding="utf-8").replace("−", "-")


def _unsupported(page, printed):
    """Return numbers in the prose of a page that neither its code nor the benchmark printed."""
    shown = set(NUMBER.findall("\n".join(FENCE.findall(page)) + printed))
    prose = LINK.sub("", FENCE.sub("", page))
    return [number for number in NUMBER.findall(prose) if number not in shown]


def test_the_index_links_to_all_pages_and_only_these():
    linked = {target for target in LINK.findall(_text("index.md")) if target.endswith(".md")}
    assert linked == set(PAGES)
    assert len(PAGES) == 8


@pytest.mark.parametrize("name", ["index.md", *PAGES])
def test_links_and_figures_exist(name):
    for target in LINK.findall(_text(name)):
        assert (FOLDER / target).is_file(), target


def test_every_figure_is_shown_on_a_page():
    shown = {target for name in PAGES for target in LINK.findall(_text(name))}
    assert {figure.name for figure in FOLDER.glob("*.png")} <= shown


@pytest.mark.parametrize("name", PAGES)
def test_a_page_has_its_parts_and_is_short(name):
    page = _text(name)
    assert len(page.splitlines()) <= 80
    for part in ("**Statement.**", "**Why.**", "```python\n>>> ", ".png)", "## What to do"):
        assert part in page
    assert page.rstrip().splitlines()[-1].startswith(("* ", "  "))  # advice, as a list


@pytest.mark.parametrize("name", PAGES)
def test_numbers_were_printed(name):
    assert _unsupported(_text(name), _text("numbers.txt")) == []


def test_a_number_that_nothing_printed_is_found():
    page = "The rate is -1.5, not -1.7 or 0.25.\n```python\n>>> rate\n-1.5\n```\n"
    assert _unsupported(page, "technique 0: 0.25 (0.2 … 0.3)") == ["-1.7"]


def test_numbers_of_every_page_are_kept():
    sections = re.findall(r"^\S+$", _text("numbers.txt"), re.MULTILINE)
    assert sorted(f"{section}.md" for section in sections) == PAGES


def test_intervals_hold_their_estimates():
    found = re.findall(r"(-?[\d.e+-]+) \((-?[\d.e+-]+) … (-?[\d.e+-]+)\)", _text("numbers.txt"))
    assert len(found) > 100
    for value, low, high in found:
        assert float(low) <= float(value) <= float(high)


@cache
def _edge_variance(heuristic, n):
    return mcs.exact_variance(_light_edge(heuristic), "jittered", n, tolerance=1e-2)


def _edge_rate(heuristic, low, high):
    a, b = (_edge_variance(heuristic, n) for n in (low, high))
    return np.log(b / a) / np.log(high / low)


def _rate(estimator, sampler, low, high):
    a, b = (mcs.exact_variance(estimator, sampler, n, tolerance=1e-2) for n in (low, high))
    return np.log(b / a) / np.log(high / low)


def _light_edge(heuristic):
    """Return a smooth light on [0.3, 0.5] with two techniques; only the uniform one jumps."""
    light = mcs.density("piecewise-constant(values=[0, 0, 0, 1, 1, 0, 0, 0, 0, 0])", dims=1)
    f = mcs.Integrand.from_function(
        lambda x: np.where(light.pdf(x) > 0, 1 + x[..., 0], 0.0), dims=1, integral=0.28
    )
    return mcs.MultipleImportance(f, [light, "uniform"], heuristic=heuristic)


@pytest.mark.parametrize("beta", [1, 2, 4])
def test_the_power_heuristic_only_delays_the_slow_technique(beta):
    """The jumps (1 + x) p_u^(β-1)/(p_u^β + p_l^β), p_l = 5, at both edges give the variance
    Σ ({an}(1 − {an})/n²) jump², plus O(n⁻³) from the smooth part."""
    heuristic, n = f"power(beta={beta})", 16384
    cuts = np.array([0.3, 0.5]) * n % 1
    jumps = np.array([1.3, 1.5]) / (1 + 5.0**beta)
    expected = float((cuts * (1 - cuts) * jumps**2).sum()) / n**2
    rest = _edge_variance("maximum", n)
    assert _edge_variance(heuristic, n) == pytest.approx(expected + rest, rel=0.05)
    assert _edge_rate(heuristic, 4, 16) > (-2.5 if beta < 4 else -3.1)
    assert _edge_rate("maximum", 4, 16) == pytest.approx(-3.0, abs=1e-6)


def test_larger_powers_are_lower_and_slow_down_later():
    """The rate exceeds −2.5 immediately for balance, and after hundreds of points for β = 4."""
    early = [_edge_rate(f"power(beta={b})", 4, 16) for b in (1, 4)]
    late = [_edge_rate(f"power(beta={b})", 1024, 4096) for b in (1, 4)]
    assert early[0] > -2.5 > early[1]
    assert min(late) > -2.5


def test_a_mixture_by_a_coordinate_slows_the_rate_and_a_split_keeps_it():
    """For f = x², p = 2x and a tenth of uniform points; an integer n · share is a border."""
    f = mcs.integrand("polynomial(coefficients=[0, 0, 1])", dims=1)
    safe = mcs.density("defensive(density='linear(slope=2)', share=0.1)", dims=1)
    mixed, split = mcs.Estimator(f, safe), mcs.estimators.split_mixture(f, safe)
    assert _rate(mixed, "jittered", 64, 256) == pytest.approx(-2.0, abs=0.1)
    assert _rate(mixed, "jittered", 80, 320) == pytest.approx(-3.0, abs=0.1)
    assert _rate(split, "jittered", 7, 28) == pytest.approx(-3.0, abs=0.1)
    assert mcs.exact_variance(split, "jittered", 25) < 0.05 * mcs.exact_variance(
        mixed, "jittered", 256
    )
