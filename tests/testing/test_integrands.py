"""Checks for users' integrands: faults are found, registered integrands pass."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.core.errors import ParameterError
from mcspectra.integrands import INTEGRANDS
from mcspectra.testing import BrokenContract, check_integrand

WAVE = mcs.integrand("gaussian(center=[0.3, 0.6], width=0.3)")


class Sound:
    """A Gaussian with all closed forms, of which tests make faulty variants."""

    name: ClassVar[str] = "made"

    def _evaluate(self, x):
        return WAVE(x)

    def _integral(self):
        return WAVE.integral

    def _fourier(self, m):
        return WAVE.fourier(m)

    def box_moments(self, lo, hi):
        return WAVE.box_moments(lo, hi)


def made(**changes):
    members = {k: v for k, v in vars(Sound).items() if not k.startswith("__")} | changes
    cls = type("Made", (mcs.Integrand,), {"__annotations__": {"dims": int}, "dims": 2, **members})
    return dataclass(frozen=True, kw_only=True)(cls)()


def raising(*_):
    raise ZeroDivisionError("no luck")


def scribbling(_, x):
    values = WAVE(x)
    x += 0.1
    return values


def moments(k, factor):
    def changed(_, lo, hi):
        found = list(WAVE.box_moments(lo, hi))
        found[k] = factor * found[k]
        return tuple(found)

    return changed


def one_axis(_, m):
    return WAVE.fourier(m * np.array([1.0, -1.0]))


FAULTS = {
    "raises": ({"_evaluate": raising}, "fails in its values: ZeroDivisionError: no luck"),
    "shape": (
        {"_evaluate": lambda _, x: x},
        r"gives shape \(3, 5, 2\) in its values, not \(3, 5\)",
    ),
    "type": ({"_evaluate": lambda _, x: WAVE(x).astype("f4")}, "gives float32 in its values, not"),
    "no array": ({"_evaluate": lambda _, x: WAVE(x).tolist()}, "gives list in its values, not"),
    "infinite": ({"_evaluate": lambda _, x: WAVE(x) / 0.0}, "not finite"),
    "input changed": ({"_evaluate": scribbling}, "changes the points"),
    "others": ({"_evaluate": lambda _, x: WAVE(x) + x.mean()}, "a point alone"),
    "breaks": ({"breaks": ((1.0,), ())}, "do not ascend"),
    "axes of breaks": ({"breaks": ((),)}, "breaks for 1 axes, not 2"),
    "integral": ({"_integral": lambda _: 1.001 * WAVE.integral}, "has an integral in conflict|f_0"),
    "integral shape": ({"_integral": lambda _: np.ones(2)}, r"integral of shape \(2,\)"),
    "integral NaN": ({"_integral": lambda _: np.nan}, "integral that is not finite"),
    "f_0": ({"_fourier": lambda _, m: WAVE.fourier(m) + 1e-3 * (m == 0).all(axis=-1)}, "f_0"),
    "conjugate": (
        {"_fourier": lambda _, m: WAVE.fourier(-m)},
        "has coefficients in conflict with its values",
    ),
    "one axis mirrored": ({"_fourier": one_axis}, "has coefficients in conflict with its values"),
    "not Hermitian": (
        {"_fourier": lambda _, m: WAVE.fourier(m) * np.exp(1j * np.abs(m).sum(axis=-1))},
        "f_-m ≠",
    ),
    "coefficient type": ({"_fourier": lambda _, m: WAVE.fourier(m).real}, "float64, not complex"),
    "coefficient shape": ({"_fourier": lambda _, m: WAVE.fourier(m)[..., None]}, "of shape"),
    "coefficients raise": ({"_fourier": raising}, "no luck"),
    "mean over boxes": (
        {"box_moments": moments(0, 1.001)},
        "has box moments in conflict with its values",
    ),
    "square over boxes": (
        {"box_moments": moments(1, 1.001)},
        "has box moments in conflict with its values",
    ),
    "boxes": (
        {"box_moments": lambda _, lo, hi: WAVE.box_moments(np.zeros_like(lo), hi)},
        "has box moments in conflict with its values",
    ),
}


@pytest.mark.parametrize(("changes", "words"), FAULTS.values(), ids=FAULTS)
def test_faults_are_found(changes, words):
    with np.errstate(divide="ignore"), pytest.raises(BrokenContract, match=words):
        check_integrand(made(**changes))


def test_a_sound_integrand_passes():
    check_integrand(made())
    check_integrand(made(_integral=lambda _: None, _fourier=lambda *_: None))


def small(integral):
    """Return a disk with a landmark; 131 072 points hit it 0.07 times on average."""
    disk = mcs.integrand("disk(center=[0.37, 0.61], radius=0.0004)")
    return made(
        _evaluate=lambda _, x: disk(x),
        _integral=lambda _: integral * disk.integral,
        _fourier=lambda *_: None,
        box_moments=lambda _, lo, hi: disk.box_moments(lo, hi),
        landmarks=lambda _: np.array([[0.37, 0.61]]),
    )


def test_small_regions_are_checked_with_landmarks():
    check_integrand(small(1.0))
    with pytest.raises(BrokenContract, match="but points give 0"):
        check_integrand(small(1e4))


SPECS = [
    ("constant(value=-2.5)", 2),
    ("linear(gradient=[1, -2, 0.5], offset=0.3)", 3),
    ("polynomial(coefficients=[1, 2, -3])", 1),
    ("gaussian(width=0.4)", 5),
    ("cosine(frequency=[1, -2], phase=-1)", 2),
    ("step(at=0.7, axis=1)", 2),
    ("smoothed-step(at=0.437, width=0.2)", 1),
    ("disk(radius=0.4)", 3),
    ("half-space(normal=[-1, 0.3], offset=-0.4)", 2),
    ("image(values=[[[1, -1], [2, 0]], [[4, 1], [5, 7]], [[0, 1], [2, 2]]])", 2),
]


@pytest.mark.parametrize(("spec", "dims"), SPECS)
def test_integrands_of_the_library_pass(spec, dims):
    check_integrand(spec, dims=dims)


def test_given_closed_forms_are_checked():
    square = mcs.Integrand.from_function(lambda x: x[..., 0] ** 2, dims=1, integral=1 / 3)
    check_integrand(square)
    wrong = mcs.Integrand.from_function(lambda x: x[..., 0] ** 2, dims=1, integral=0.334)
    with pytest.raises(BrokenContract, match="but points give 0.33333"):
        check_integrand(wrong)


@pytest.mark.parametrize("name", INTEGRANDS)
def test_registered_integrands_pass(name):
    try:
        made = mcs.integrand(name)
    except ParameterError:  # requires parameters; SPECS has a spec with parameters
        return
    check_integrand(made)


@pytest.mark.parametrize("bad", [3, None, len])
def test_other_objects_give_an_error(bad):
    with pytest.raises(ParameterError, match="is not an integrand"):
        check_integrand(bad)
