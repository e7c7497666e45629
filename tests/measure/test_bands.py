"""Bands: each named partition assigns basis functions to the right labels."""

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.measure.views import PARTITIONS, make_bands
from mcspectra.spectra.bases import BASES, make_basis


def named(bands, basis):
    return [bands.labels[b] for b in bands.of], basis.indices()


@pytest.mark.parametrize("name", PARTITIONS)
@pytest.mark.parametrize("basis", BASES)
def test_every_basis_function_belongs_to_a_labeled_band(name, basis):
    made = make_basis(basis, 2, 8)
    bands = make_bands(name, made)
    assert bands.of.shape == (made.stored,)
    assert set(bands.of) <= set(range(len(bands.labels)))
    assert bands.of[made.dc] == 0
    assert np.count_nonzero(bands.of == 0) == 1  # the band of the constant holds nothing else


def test_radial_bands_are_shells_one_frequency_wide():
    basis = make_basis("fourier", 3, 3)
    for name, m in zip(*named(make_bands("radial", basis), basis), strict=True):
        assert name == str(round(float(np.linalg.norm(m))))


def test_dyadic_bands_double():
    basis = make_basis("fourier", 1, 9)
    for name, (m,) in zip(*named(make_bands("dyadic", basis), basis), strict=True):
        low, _, high = name.partition("–")
        assert (abs(m) == 0) if not high else int(low) <= abs(m) < int(high)


def test_wedges_hold_directions_within_their_angle():
    basis = make_basis("fourier", 2, 6)
    for name, m in zip(*named(make_bands("wedge", basis), basis), strict=True):
        if name == "constant":
            continue
        direction = np.array([np.cos(a := np.radians(float(name[:-1]))), np.sin(a)])
        cosine = abs(m @ direction) / np.linalg.norm(m)
        assert cosine >= np.cos(np.radians(7.5)) - 1e-12


@pytest.mark.parametrize("name", ["walsh", "haar"])
def test_wedges_of_step_functions_depend_on_levels_only(name):
    """All wavelets of a level oscillate in one direction, wherever they lie in the square."""
    basis = make_basis(name, 2, 8)
    label, index = named(make_bands("wedge", basis), basis)
    for band, m in zip(label, index, strict=True):
        levels = [
            2.0 ** (int(i).bit_length() - 1) if i else 0.0 for i in m
        ]  # index 2^j + t has level j
        if band == "constant":
            assert not any(levels)
        else:
            apart = np.degrees(np.arctan2(levels[1], levels[0])) - float(band[:-1])
            assert abs(apart) <= 7.5


@pytest.mark.parametrize("dims", [3, 4])
def test_anova_bands_are_the_axes_that_vary(dims):
    basis = make_basis("cosine", dims, 1)
    bands = make_bands("anova", basis)
    if dims == 3:
        assert bands.labels == ("constant", "x0", "x1", "x2", "x0x1", "x0x2", "x1x2", "x0x1x2")
    for name, m in zip(*named(bands, basis), strict=True):
        assert name == ("".join(f"x{i}" for i in range(dims) if m[i]) or "constant")


@pytest.mark.parametrize("partition", PARTITIONS)
@pytest.mark.parametrize("name", BASES)
@pytest.mark.parametrize("half_width", [0, 1, 4])
def test_every_label_belongs_to_a_band_that_is_not_empty(partition, name, half_width):
    """Without negative indices, or on small grids, the last wedges are empty and have no label."""
    if half_width == 0 and name in ("walsh", "haar"):
        half_width = 2
    found = make_bands(partition, make_basis(name, 2, half_width))
    assert len(found.labels) == found.of.max() + 1


def test_given_labels():
    labels = np.abs(np.arange(-4, 5)) // 2
    d = mcs.variance_terms(
        "gaussian", mcs.sampler("random", 1), 8, half_width=4, realizations=9, bands=labels
    )
    assert d["band"].attrs["labels"] == "0, 1, 2"
