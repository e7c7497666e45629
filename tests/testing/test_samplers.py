"""Checks for users' samplers find faults."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest

from mcspectra import Sampler
from mcspectra.testing import BrokenContract, check_sampler


def made(points, dims=2):
    """Return a sampler with the given function as `_points`."""
    size = dims

    @dataclass(frozen=True, kw_only=True)
    class Made(Sampler):
        """Sampler for a test."""

        name: ClassVar[str] = "made"
        dims: int = size

        def _points(self, n, stream, first, count):
            return points(self, n, stream, first, count)

    return Made()


def sound(self, n, stream, first, count):
    return stream.uniforms(first, count, n * 2).reshape(count, n, 2)


FAULTS = {
    "no array": (lambda *a: sound(*a).tolist(), "gives list, not an array"),
    "shape": (lambda *a: sound(*a)[:, :-1], r"gives shape \(3, 15, 2\), not \(3, 16, 2\)"),
    "type": (lambda *a: sound(*a).astype(np.float32) * 0.5, "gives float32, not float64"),
    "range": (lambda *a: 1.0 - sound(*a) * 0.0, r"from 1.0 to 1.0, not in \[0,1\)"),
    "negative": (lambda *a: sound(*a) - 0.5, r"not in \[0,1\)"),
    "call": (
        lambda s, n, stream, first, count: sound(s, n, stream.child(count), first, count),
        "in another call",
    ),
    "bias": (lambda *a: sound(*a) ** 1.1, "its points are not uniform"),
    "one coordinate": (lambda *a: sound(*a) * [1.0, 0.0] + [0.0, 0.5], "not uniform"),
    "a corner": (lambda *a: np.where(sound(*a) > 0.9, 0.5, sound(*a)), "not uniform"),
}


@pytest.mark.parametrize(("points", "words"), FAULTS.values(), ids=FAULTS)
def test_faults_are_found(points, words):
    with pytest.raises(BrokenContract, match=f"^made with n = 16 .*{words}"):
        check_sampler(made(points))


def test_a_sound_sampler_passes():
    check_sampler(made(sound))
    for spec in ("sobol | owen", "jittered", "latin-hypercube", "rank1-lattice | shift"):
        check_sampler(spec)


def test_middle_coordinates_are_checked():
    def flat(self, n, stream, first, count):
        points = stream.uniforms(first, count, n * 3).reshape(count, n, 3)
        points[..., 1] = 0.5
        return points

    with pytest.raises(BrokenContract, match="not uniform"):
        check_sampler(made(flat, dims=3))
