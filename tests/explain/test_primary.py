"""The primary-space picture: inner and boundary jumps, poles, and zeros of p."""

import math

import numpy as np
import pytest

import mcspectra as mcs


def picture(integrand, density=None, **options):
    dims = options.pop("dims", 2)
    return mcs.explain.primary_picture(mcs.Estimator(integrand, density, dims=dims), **options)


def by_kind(data, name):
    return [float(data[name].sel(kind=kind)) for kind in ("interior", "boundary")]


def test_importance_sampling_can_create_a_boundary_jump():
    """f = 1 is periodic; f/p with p = 1 + s(x − ½) jumps by 1/(1 − s/2) − 1/(1 + s/2)."""
    plain = picture("constant", dims=1, resolution=32)
    assert by_kind(plain, "primary_jump_length") == [0, 0]
    data = picture("constant", "linear(slope=1)", dims=1, resolution=32)
    assert by_kind(data, "primary_jump_length") == [0, 1]
    # Values are evaluated at a distance of 2^-40 from the sides
    height = 2 - 2 / 3
    assert by_kind(data, "primary_jump_height")[1] == pytest.approx(height, rel=1e-10)
    assert data["face_jump"].values == pytest.approx([height], rel=1e-10)
    assert int(data["reciprocal_unbounded"]) == 0


def test_importance_sampling_can_remove_a_boundary_jump():
    """For f = p, g is constant although f is not periodic."""
    f = mcs.integrand("linear(gradient=1, offset=0.5)", dims=1)
    assert by_kind(picture(f, dims=1, resolution=32), "primary_jump_height")[1] == pytest.approx(1)
    data = picture(f, "linear(slope=1)", dims=1, resolution=32)
    np.testing.assert_allclose(data["primary_value"], 1.0, rtol=1e-14)
    assert by_kind(data, "primary_jump_length") == [0, 0]


def test_jumps_at_edges_of_the_integrand():
    data = picture("step(at=0.3)", dims=1, resolution=64)
    assert by_kind(data, "primary_jump_length") == [1, 1]
    assert by_kind(data, "primary_jump_height") == [1, 1]
    disk = picture("disk(radius=0.3)", resolution=128)
    assert by_kind(disk, "primary_jump_length")[0] == pytest.approx(2 * math.pi * 0.3, rel=0.05)
    half = picture("half-space(normal=[1, 0], offset=0.5)", resolution=64)
    # A line inside jumps, and at the boundary the whole side across x_0, but not that across x_1
    assert by_kind(half, "primary_jump_length") == [1, 1]
    assert (half["face_jump"].sel(axis=0) == 1).all()
    assert (half["face_jump"].sel(axis=1) == 0).all()


def test_jumps_at_edges_of_the_density():
    """For a table, g = 1/p jumps where p does: here between 2/3 and 2 at u = 3/4."""
    data = picture("constant", "piecewise-constant(values=[3, 1])", dims=1, resolution=64)
    place = np.flatnonzero(data["primary_jump"].values[0])
    np.testing.assert_array_equal(place, [int(0.75 * 64 - 0.5)])
    assert by_kind(data, "primary_jump_height") == pytest.approx([2 - 2 / 3] * 2)


def test_a_warp_can_move_a_boundary_jump_inside():
    """Of two warps of one pdf, only the concentric warp moves the jump at φ = 0 inside."""
    f = mcs.Integrand.from_function(lambda x: x[..., 0] * np.sin(np.pi * x[..., 1]), dims=2)
    inside, outside = (
        by_kind(picture(f, f'sphere(warp="{warp}")', resolution=64), "primary_jump_length")[0]
        for warp in ("concentric", "polar")
    )
    assert inside == 0.5
    assert outside == 0


def test_zeros_of_the_density_at_the_boundary_give_poles():
    data = picture("constant", "linear(slope=2)", dims=1, resolution=32)
    assert by_kind(data, "primary_pole") == [0, 1]
    assert by_kind(data, "primary_jump_height")[1] == math.inf
    assert int(data["reciprocal_unbounded"]) == 1
    bounded = picture("linear", "linear(slope=2)", dims=1, resolution=32)
    assert by_kind(bounded, "primary_pole") == [0, 0]
    assert int(bounded["reciprocal_unbounded"]) == 1


def test_shared_zeros_of_f_and_p_give_no_poles():
    data = picture("disk(radius=0.2)", "disk(radius=0.4)", resolution=32)
    assert int(data["reciprocal_unbounded"]) == 1
    assert by_kind(data, "primary_pole") == [0, 0]


def test_pictures_of_techniques_and_channels():
    mis = mcs.MultipleImportance("constant", ["linear(slope=1)", "uniform"], dims=1)
    first, second = (mcs.explain.primary_picture(mis, technique=t, resolution=16) for t in (0, 1))
    # The balance heuristic gives w f/p_t = 1/(p_0 + p_1): 1/1.5 and 1/2.5 at the ends
    for data in (first, second):
        height = by_kind(data, "primary_jump_height")[1]
        assert height == pytest.approx(1 / 1.5 - 1 / 2.5, rel=1e-9)
    assert not np.allclose(first["primary_value"], second["primary_value"])
    colors = mcs.Integrand.from_function(
        lambda x: np.stack([3.0 * (x[..., 0] > 0.5), 4.0 * (x[..., 0] > 0.5)], axis=-1), dims=1
    )
    data = mcs.explain.primary_picture(colors, resolution=16)
    assert data["primary_value"].dims == ("u0", "channel")
    assert by_kind(data, "primary_jump_height") == pytest.approx([5, 5])


def test_a_narrow_zero_of_a_table_is_found():
    """The zero lies between the probes, but the density reports its empty cells."""
    values = np.ones(997)
    values[500] = 0
    f = mcs.Integrand.from_function(lambda x: 1.0 * (np.abs(x[..., 0] - 0.502) > 0.002), dims=1)
    table = mcs.densities.PiecewiseConstant(values=values)
    assert int(picture(f, table, dims=1, resolution=16)["reciprocal_unbounded"]) == 1
