"""Result variables of the three terms, with their errors, from sums over realisations."""

from __future__ import annotations

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.estimators import Moments
from mcspectra.estimators.moments import rounding_floor
from mcspectra.variance.batches import Batches, Variables, student_t
from mcspectra.variance.sums import Partition, SpectralSums
from mcspectra.variance.views import View

__all__ = ["term_errors", "term_variables"]

_TERMS = ("dc_term", "power_term", "cross_term")


def term_variables(
    sums: SpectralSums, measured: Moments, view: View, partition: Partition
) -> Variables:
    """All result variables with a leading channel axis."""
    f, basis = partition.coefficients, view.basis
    degrees = sums.count - 1
    spectrum = sums.m2 / degrees
    diagonal = np.abs(f) ** 2 * spectrum
    dc, power, cross = sums.terms(partition)
    total = dc + power + cross
    shape = (len(f), len(view.transforms), basis.stored)
    # A variance of rounding noise captures nothing.
    real = np.where(measured.variance > rounding_floor(measured.mean), measured.variance, np.nan)
    captured = total / real
    curve = sums.truncated.variance / real[:, None]
    maps = ("channel", "technique", *basis.names)
    by_width = ("channel", "half_width")
    variables: Variables = {
        "dc_term": (("channel",), dc),
        "power_term": (("channel",), power),
        "cross_term": (("channel",), cross),
        "predicted_variance": (("channel",), total),
        "predicted_variance_ci": (("channel", "bound"), sums.truncated.variance_ci[:, -1]),
        "measured_variance": (("channel",), measured.variance),
        "measured_variance_ci": (("channel", "bound"), measured.variance_ci),
        "mean": (("channel",), measured.mean),
        "mean_se": (("channel",), measured.mean_se),
        "captured": (("channel",), captured),
        "contribution": (maps, basis.full(sums.contribution(partition).reshape(shape))),
        "power_contribution": (maps, basis.full(diagonal.reshape(shape))),
        "band_covariance": (("channel", "band", "band_other"), sums.band_m2 / degrees),
        "truncated_variance": (by_width, sums.truncated.variance),
        "captured_by_half_width": (by_width, curve),
    }
    if sums.matrix is not None:
        variables |= _matrices(sums.matrix / degrees, f, view)
    return variables


def term_errors(
    batches: Batches, variables: Variables, view: View, partition: Partition
) -> Variables:
    """Standard errors and 95 % intervals by batch means; NaN where fewer than two blocks say them."""
    basis = view.basis
    shape = (len(partition.coefficients), len(view.transforms), basis.stored)
    captured, half = variables["captured"][1], batches.captured_half()
    contribution = batches.contribution.error().reshape(shape)
    found: Variables = {
        "captured_ci": _interval(captured, half),
        "contribution_se": (("channel", "technique", *basis.names), basis.full(contribution)),
        "band_covariance_se": (
            ("channel", "band", "band_other"),
            batches.band_covariance.error(),
        ),
    }
    for name, error in zip(_TERMS, batches.term_errors(), strict=True):
        found[f"{name}_se"] = (("channel",), error)
        found[f"{name}_ci"] = _interval(variables[name][1], student_t(batches.count) * error)
    if batches.matrix is not None:
        found |= _matrix_errors(batches.matrix.error(), partition.coefficients, view)
    return found


def _interval(value: Array, half: Array) -> tuple[tuple[str, ...], Array]:
    return ("channel", "bound"), np.stack([value - half, value + half], axis=-1)


def _matrix_errors(stored: Array, f: Array, view: View) -> Variables:
    """Errors of C_ml and conj(f_m) f_l C_ml: conjugates have the same, |f_m f_l| scales them."""
    index, flip = _whole(view)
    error = _signed(stored, index, flip)
    size = np.abs(f[:, index])
    return {
        "coefficient_covariance_se": (("m", "l"), error),
        "cross_matrix_se": (("channel", "m", "l"), size[:, :, None] * size[:, None, :] * error),
    }


def _matrices(stored: Array, f: Array, view: View) -> Variables:
    """Full C_ml and conj(f_m) f_l C_ml from the covariances of what is stored, with and without conj.

    S_{−l} = conj S_l gives C_{m,−l} = Cov(S_m, conj S_l), the pseudo-covariance. In primary space
    the coefficients of the techniques follow one another.
    """
    index, flip = _whole(view)
    c = _signed(stored, index, flip)
    whole = f[:, index]
    whole = np.where(flip, whole.conj(), whole)
    return {
        "coefficient_covariance": (("m", "l"), c),
        "cross_matrix": (("channel", "m", "l"), whole.conj()[:, :, None] * whole[:, None, :] * c),
    }


def _whole(view: View) -> tuple[Array, Array]:
    """For each coefficient of each technique: its place among those stored, whether conjugate."""
    techniques, h = len(view.transforms), view.basis.stored
    place, conjugate = view.basis.whole()
    return (np.arange(techniques)[:, None] * h + place).ravel(), np.tile(conjugate, techniques)


def _signed(stored: Array, index: Array, flip: Array) -> Array:
    """⟨S_a conj S_b⟩ for a, b plain or conjugated, from the stored blocks with and without conj."""
    size = len(stored)
    plain, pseudo = stored[:, :size][np.ix_(index, index)], stored[:, size:][np.ix_(index, index)]
    both = np.where(flip[:, None], plain.conj(), plain)
    mixed = np.where(flip[:, None], pseudo.conj(), pseudo)
    return np.asarray(np.where(flip[:, None] == flip[None, :], both, mixed))
