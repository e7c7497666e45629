"""Checks for users' densities: faults are found, registered densities pass."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.core.errors import ParameterError
from mcspectra.densities import DENSITIES
from mcspectra.testing import BrokenContract, check_density


class Sound:
    """The density 2x with the warp √u, of which tests make faulty variants."""

    name: ClassVar[str] = "made"

    def _pdf(self, x):
        return 2.0 * x[..., 0]

    def _sample(self, u):
        return np.sqrt(u)

    def _invert(self, x):
        return x**2

    def reciprocal_integral(self):
        return np.inf


def made(**changes):
    members = {k: v for k, v in vars(Sound).items() if not k.startswith("__")} | changes
    cls = type("Made", (mcs.Density,), {"__annotations__": {"dims": int}, "dims": 1, **members})
    return dataclass(frozen=True, kw_only=True)(cls)()


def raising(*_):
    raise ZeroDivisionError("no luck")


def scribbling(_, x):
    x *= 0.5
    return 4.0 * x[..., 0]


FAULTS = {
    "pdf raises": ({"_pdf": raising}, "fails in pdf: ZeroDivisionError: no luck"),
    "pdf shape": ({"_pdf": lambda _, x: 2.0 * x}, r"shape \(3, 5, 1\) in pdf, not \(3, 5\)"),
    "pdf type": ({"_pdf": lambda _, x: np.float32(2.0) * x[..., 0].astype("f4")}, "float32 in pdf"),
    "pdf no array": ({"_pdf": lambda _, x: (2.0 * x[..., 0]).tolist()}, "gives list in pdf"),
    "pdf negative": ({"_pdf": lambda _, x: 4.0 * x[..., 0] - 1.0}, "negative"),
    "pdf NaN": ({"_pdf": lambda _, x: np.where(x[..., 0] > 0.9, np.nan, 2 * x[..., 0])}, "not"),
    "mass": ({"_pdf": lambda _, x: 2.002 * x[..., 0]}, "integrates to 1.001"),
    "other pdf": ({"_pdf": lambda _, x: 0.1 + 1.8 * x[..., 0]}, "do not follow"),
    "input changed": ({"_pdf": scribbling}, "changes the points given to pdf"),
    "sample raises": ({"_sample": raising}, "fails in sample"),
    "sample shape": ({"_sample": lambda _, u: np.sqrt(u[..., 0])}, r"shape \(3, 5\) in sample"),
    "sample outside": ({"_sample": lambda _, u: 1.2 * np.sqrt(u)}, "leave"),
    "sample of others": (
        {"_sample": lambda _, u: np.sqrt(np.sort(u, axis=-2)) if u.ndim > 1 else np.sqrt(u) * 0.9},
        "for a point alone",
    ),
    "other samples": ({"_sample": lambda _, u: u**0.52}, "do not follow"),
    "invert": ({"_invert": lambda _, x: x**2.1}, "so invert is wrong"),
    "invert mirrored": ({"_invert": lambda _, x: 1.0 - x**2}, "so invert is wrong"),
    "no share": ({"breaks": ((0.5, 1.5),)}, r"which do not ascend within \(0, 1\)"),
    "descending": ({"breaks": ((0.5, 0.25),)}, "do not ascend"),
    "axes": ({"breaks": ((), ())}, "breaks for 2 axes, not 1"),
    "reciprocal": ({"reciprocal_integral": lambda _: 0.5}, "less than 1"),
    "reciprocal raises": ({"reciprocal_integral": raising}, "fails in reciprocal_integral"),
}


@pytest.mark.parametrize(("changes", "words"), FAULTS.values(), ids=FAULTS)
def test_faults_are_found(changes, words):
    with pytest.raises(BrokenContract, match=words):
        check_density(made(**changes))


def test_a_sound_density_passes():
    check_density(made())


def test_a_wrong_reciprocal_integral_is_found():
    inner = mcs.density("linear(slope=1)", dims=1)
    off = {
        "_pdf": lambda _, x: inner.pdf(x),
        "_sample": lambda _, u: inner.sample(u),
        "_invert": lambda _, x: inner.invert(x),
        "reciprocal_integral": lambda _: 1.02 * np.log(3.0),
    }
    with pytest.raises(BrokenContract, match="gives 1.12.* for ∫1/p"):
        check_density(made(**off))


def test_samples_with_density_zero_are_found():
    two = {
        "_pdf": lambda _, x: 2.0 * (x[..., 0] < 0.5),
        "_sample": lambda _, u: np.where(u < 0.99, 0.5 * u, 0.75),
        "has_inverse": False,
        "reciprocal_integral": lambda _: np.inf,
    }
    with pytest.raises(BrokenContract, match="do not follow|of density 0"):
        check_density(made(**two))


def test_wrong_axes_in_two_dims_are_found():
    swapped = {
        "dims": 2,
        "_pdf": lambda _, x: 2.0 * x[..., 1],
        "_sample": lambda _, u: np.stack([np.sqrt(u[..., 0]), u[..., 1]], axis=-1),
        "has_inverse": False,
    }
    with pytest.raises(BrokenContract, match="do not follow"):
        check_density(made(**swapped))


SPECS = [
    ("linear(slope=2)", 1),
    ("linear(slope=[1.5, -0.7])", 2),
    ("truncated-normal(mean=[0, 1, -0.1], sigma=[0.2, 0.5, 1])", 3),
    ("power(exponent=-0.5)", 1),
    ("exponential(rate=[0, -5])", 2),
    ("piecewise-constant(values=[0, 3, 1, 0, 0, 2, 0])", 1),
    ("piecewise-linear(values=[0, 3, 1, 0, 0, 0, 2])", 1),
    ("mixture(parts=['uniform', 'tent(peak=0.1)', 'linear'], selection='extra')", 1),
    ("defensive(density='power(exponent=3)', share=0.2)", 1),
    ("product(parts=['tent', 'linear(dims=2, slope=[1, 0.5])', 'power'])", 4),
]


@pytest.mark.parametrize(("spec", "dims"), SPECS)
def test_densities_of_the_library_pass(spec, dims):
    check_density(spec, dims=dims)


@pytest.mark.parametrize("name", DENSITIES)
def test_registered_densities_pass(name):
    try:
        made = mcs.density(name)
    except ParameterError:  # requires parameters; SPECS has a spec with parameters
        return
    check_density(made)


@pytest.mark.parametrize("bad", [3, object(), [1.0]])
def test_other_objects_give_an_error(bad):
    with pytest.raises(ParameterError, match="is not a density"):
        check_density(bad)
    with pytest.raises(BrokenContract, match="None is not a density"):
        check_density(None)
