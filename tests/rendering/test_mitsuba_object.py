"""Sampler objects of Mitsuba as samplers: points, counts read back, and invalid objects."""

import numpy as np
import pytest

from mcspectra.core.errors import CountError, ParameterError
from mcspectra.rendering import from_mitsuba, register_samplers
from mcspectra.rendering.backend import import_mitsuba
from mcspectra.rendering.point_sampler import MitsubaSampler

pytestmark = pytest.mark.render

VARIANTS = ["scalar_rgb", "llvm_ad_rgb"]


def made(variant, **properties):
    register_samplers(variant)
    mitsuba = import_mitsuba()
    mitsuba.set_log_level(mitsuba.LogLevel.Error)  # Mitsuba otherwise reports every rounding
    mitsuba.set_variant(variant)
    return mitsuba.load_dict(properties)


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("kind", ["stratified", "multijitter", "ldsampler", "mcspectra"])
def test_every_realization_has_the_strata_of_its_kind(variant, kind):
    points = from_mitsuba(made(variant, type=kind, sample_count=4), 3).draw(
        16, realizations=5, rng=1
    )
    cells = np.floor(points[..., :2] * 4) @ [4, 1]
    assert points.shape == (5, 16, 3)
    assert (np.sort(cells, axis=1) == np.arange(16)).all()
    assert len(np.unique(points[..., 0])) > 16 * 3  # realizations differ


@pytest.mark.parametrize("variant", VARIANTS)
def test_realizations_do_not_depend_on_how_many_are_drawn(variant):
    source = made(variant, type="independent")
    source.seed(3, 8)
    sampler = from_mitsuba(source)
    whole = sampler.draw(8, realizations=4, rng=5)
    np.testing.assert_array_equal(whole[2:], sampler.draw(8, realizations=2, first=2, rng=5))
    assert source.sample_count() == 4  # points come from a fork, so the object keeps its count


def test_scalar_objects_draw_the_points_of_the_spec():
    sampler = from_mitsuba(made("scalar_rgb", type="multijitter"), 3)
    expected = MitsubaSampler(sampler="multijitter", dims=3).draw(12, realizations=3, rng=2)
    np.testing.assert_array_equal(sampler.draw(12, realizations=3, rng=2), expected)


def test_counts_are_read_back():
    sampler = from_mitsuba(made("scalar_rgb", type="orthogonal", sample_count=9))
    assert sampler.spec == "mitsuba-object(OrthogonalSampler, sample_count=9)"
    with pytest.raises(CountError, match="the nearest count is 25"):
        sampler.draw(16)
    with pytest.raises(CountError, match="nearest counts are 9 and 16"):
        from_mitsuba(made("scalar_rgb", type="mcspectra", spec="jittered")).draw(15)


@pytest.mark.parametrize("source", [None, "multijitter", 3, np.zeros((4, 2))])
def test_objects_that_are_not_mitsuba_samplers_raise(source):
    with pytest.raises(ParameterError, match="is not a sampler of Mitsuba"):
        from_mitsuba(source)


def test_classes_and_bad_dims_are_refused():
    source = made("scalar_rgb", type="independent")
    with pytest.raises(ParameterError, match="is not a sampler of Mitsuba"):
        from_mitsuba(type(source))
    with pytest.raises(ParameterError, match="dims is 0"):
        from_mitsuba(source, 0)
