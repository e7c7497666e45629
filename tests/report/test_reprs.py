"""Notebook representations of components: well-formed, correct and cheap."""

import time
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.densities import DENSITIES
from mcspectra.integrands import INTEGRANDS
from mcspectra.report.reprs import component_html
from mcspectra.samplers import SAMPLERS


def parsed(component):
    """Return the rows of the table and the number of images."""
    page = ET.fromstring(component_html(component))
    rows = {r[0].text or "": r[1].text for r in page.iter("tr")}
    return rows, sum(e.tag.endswith("svg") for e in page.iter())


def made(make, name):
    try:
        return make(name)
    except mcs.McspectraError:  # needs parameters
        return None


FAMILIES = [(SAMPLERS, mcs.sampler), (DENSITIES, mcs.density), (INTEGRANDS, mcs.integrand)]
ALL = [c for names, make in FAMILIES for n in names if (c := made(make, n)) is not None]


@pytest.mark.parametrize("component", ALL, ids=lambda c: f"{type(c).__name__}")
def test_all_registered_components_have_a_representation(component):
    rows, pictures = parsed(component)
    assert pictures == 1 or "take long" in rows["picture"]
    assert rows["dims"].startswith(str(component.dims))


@pytest.mark.parametrize("dims", [1, 5])
def test_registered_components_in_other_dims_have_a_representation(dims):
    made_so = [
        component
        for names, make in FAMILIES
        for name in names
        if (component := made(lambda spec, make=make: make(spec, dims=dims), name)) is not None
    ]
    assert len(made_so) > 40
    for component in made_so:
        assert parsed(component)[0]["dims"].startswith(str(dims))


@pytest.mark.parametrize("integrand", ["disk", "gaussian", "cosine"])
def test_estimators_of_every_density_are_shown(integrand):
    shown = 0
    for name in DENSITIES:
        estimator = made(lambda p: mcs.Estimator(integrand, p), name)
        if estimator is not None:
            assert parsed(estimator)[0]["techniques"] == "1"
            shown += 1
    assert shown > 8


@pytest.mark.parametrize("dims", [1, 2, 3, 40])
def test_all_dims_are_shown(dims):
    for component in (
        mcs.sampler("random | shift", dims=dims),
        mcs.density("linear(slope=0.5)", dims=dims),
        mcs.integrand("gaussian", dims=dims),
    ):
        assert parsed(component)[1] == 1
    assert parsed(mcs.Estimator("gaussian", "linear(slope=0.5)", dims=dims))[1] == 3


def test_figures_agree_with_the_component():
    rows, _ = parsed(mcs.density("linear(slope=1)", dims=1))
    assert float(rows["∫ 1/p"]) == pytest.approx(np.log(3), abs=6e-3)  # three digits
    rows, _ = parsed(mcs.integrand("linear(gradient=[1, 1], offset=0.25)"))
    assert rows["∫ f"] == "1.25000"
    rows, _ = parsed(mcs.sampler("regular"))
    assert rows["smallest distance"].startswith("0.125 ")
    assert rows["unbiased"] == "no"


def test_the_smallest_distance_is_toroidal():
    rows, _ = parsed(mcs.Sampler.from_points([[0.02, 0.5], [0.97, 0.5], [0.5, 0.0]]))
    assert rows["smallest distance"].startswith("0.0500")


def test_each_technique_has_an_image():
    mis = mcs.MultipleImportance("gaussian", ["linear", "uniform"], counts=(1, 2))
    rows, pictures = parsed(mis)
    assert pictures == 3
    assert rows["samples"] == "n + 2 n"


def test_channels_are_counted():
    rows, pictures = parsed(mcs.integrand("environment"))
    assert (rows["channels"], pictures) == ("3", 1)


def test_markup_in_specs_is_escaped():
    def draw(n, generator):
        return generator.random((n, 2))

    draw.__name__ = "<script>"
    html = component_html(mcs.Sampler.from_function(draw, dims=2))
    assert "<script>" not in html
    ET.fromstring(html)


def test_randomizations_have_a_sentence():
    assert mcs.samplers.Shift.summary() in "".join(
        ET.fromstring(component_html(mcs.samplers.Shift())).itertext()
    )


def test_slow_functions_have_no_image():
    calls = []

    def slow(x):
        calls.append(time.sleep(0.15))
        return x[..., 0]

    _, pictures = parsed(mcs.Integrand.from_function(slow, dims=2, integral=0.5))
    assert pictures == 0
    assert len(calls) <= 6  # one call checks the shape


def test_costly_parts_are_found_in_nested_components():
    @dataclass(frozen=True, kw_only=True)
    class Costly(mcs.Integrand):
        """Integrand that would take a day."""

        name: ClassVar[str] = "costly"
        costly: ClassVar[bool] = True
        dims: int = 2

        def _evaluate(self, x):
            raise AssertionError(f"evaluated at {x}")

    assert parsed(Costly())[1] == 0
    estimator = object.__new__(mcs.Estimator)
    estimator.integrand, estimator.density = Costly(), None
    assert parsed(estimator)[1] == 0
    assert parsed(mcs.sampler("bnot").then(mcs.samplers.Shift()))[1] == 0


def test_huge_sets_are_not_drawn():
    rows, pictures = parsed(mcs.sampler("orthogonal-array", dims=100))
    assert pictures == 0
    assert "10201 points" in rows["picture"]


def test_poles_and_zeros_give_valid_images():
    p = mcs.Density.from_functions(pdf=lambda x: 2 * x[..., 0], sample=np.sqrt, invert=np.square)
    assert parsed(p)[1] == 1
    assert parsed(mcs.Estimator("gaussian", "power(exponent=5)", dims=1))[1] == 3
