"""Growth with the number of dims: findings, and what would contradict them."""

from __future__ import annotations

import numpy as np
import pytest

from mcspectra.integrands.registry import integrand
from mcspectra.report.reproduction import _dimension_terms as terms
from mcspectra.report.reproduction import dimensionality as module
from mcspectra.report.reproduction.base import Exhibit


@pytest.fixture(scope="module")
def made() -> Exhibit:
    return module.exhibit(quick=True, seed=1)


def test_all_findings_agree(made: Exhibit) -> None:
    assert made.name == "dimensionality"
    assert [f.statement for f in made.findings if f.agrees is not True] == []
    assert all(len(p.alt) > 40 for p in made.pictures)


def test_entries_count_pairs_of_frequencies() -> None:
    assert terms.entries(1, 64) == 129**2
    assert terms.entries(3, 1) == 27**2


def test_subsets_are_those_of_the_axes() -> None:
    found = terms.subsets(2, 1).reshape(3, 3)
    assert found.tolist() == [[3, 1, 3], [2, 0, 2], [3, 1, 3]]


def test_bands_carry_the_names_of_their_subsets() -> None:
    data = terms.bell_terms("random", 3, (8, 1), 4, 1)
    names = data["band"].attrs["labels"].split(", ")
    subsets = terms.labelled_subsets(data)
    assert sorted(subsets) == list(range(8))
    ones = [subset.bit_count() for subset in subsets]
    assert ones == sorted(ones), names


def test_maps_that_are_off_disagree() -> None:
    data = terms.with_matrix(2, 20, 1)
    assert module._map_is_row_sums(2, data).agrees is True
    wrong = data.assign(
        contribution=data["contribution"] * 1.001, band_covariance=2 * data["band_covariance"]
    )
    assert module._map_is_row_sums(2, wrong).agrees is False
    assert module._bands_are_blocks(2, wrong).agrees is False
    assert module._map_sums(2, wrong).agrees is False
    assert module._map_holds_the_third({2: wrong}).agrees is False


def test_other_samplers_have_other_bands() -> None:
    data = terms.run_terms("latin-hypercube", 3, 100, 1)
    assert module._anova(data).agrees is False
    assert module._main_effects(dict.fromkeys(module._SAMPLERS, data)).agrees is False


def test_the_components_are_those_of_the_product() -> None:
    """A product of three equal factors with mean a and mean square b: of one axis (b − a²) a⁴."""
    side = np.abs(integrand(terms.BELL, 1).fourier_grid(8)) ** 2
    mean_square, mean = side.sum(), side[8]
    found = terms.components(3, 8)
    assert found[1] == pytest.approx((mean_square - mean) * mean**2, rel=1e-9)
    assert found[7] == pytest.approx((mean_square - mean) ** 3, rel=1e-9)
