"""Growth with the number of dims: findings, and what would contradict them."""

import numpy as np
import pytest

from mcspectra.integrands.registry import integrand
from mcspectra.reproduction import dimensionality as module
from mcspectra.reproduction.claims import judge


def test_entries_count_pairs_of_frequencies():
    assert module.entries(1, 64) == 129**2
    assert module.entries(3, 1) == 27**2


def test_subsets_are_those_of_the_axes():
    found = module.subsets(2, 1).reshape(3, 3)
    assert found.tolist() == [[3, 1, 3], [2, 0, 2], [3, 1, 3]]


def test_bands_carry_the_names_of_their_subsets():
    data = module.bell_terms("random", 3, (8, 1), 4, 1)
    names = data["band"].attrs["labels"].split(", ")
    subsets = module.labelled_subsets(data)
    assert sorted(subsets) == list(range(8))
    ones = [subset.bit_count() for subset in subsets]
    assert ones == sorted(ones), names


def test_maps_that_are_off_disagree():
    data = module.bell_terms("jittered", 2, module.SMALL[2], 20, 1, matrix=True)
    assert judge(module._map_is_row_sums(2, data)).agrees is True
    wrong = data.assign(
        contribution=data["contribution"] * 1.001, band_covariance=2 * data["band_covariance"]
    )
    assert judge(module._map_is_row_sums(2, wrong)).agrees is False
    assert judge(module._bands_are_blocks(2, wrong)).agrees is False
    assert judge(module._map_sums(2, wrong)).agrees is False
    assert judge(module._map_holds_the_third({2: wrong})).agrees is False


def test_other_samplers_have_other_bands():
    data = module.bell_terms("latin-hypercube", 3, module.RUNS[3], 100, 1)
    assert judge(module._anova(data)).agrees is False
    assert judge(module._main_effects(dict.fromkeys(module.SAMPLERS, data))).agrees is False


def test_the_components_are_those_of_the_product():
    """A product of three equal factors with mean a and mean square b: of one axis (b − a²) a⁴."""
    side = np.abs(integrand(module.BELL, 1).fourier_grid(8)) ** 2
    mean_square, mean = side.sum(), side[8]
    found = module.components(3, 8)
    assert found[1] == pytest.approx((mean_square - mean) * mean**2, rel=1e-9)
    assert found[7] == pytest.approx((mean_square - mean) ** 3, rel=1e-9)
