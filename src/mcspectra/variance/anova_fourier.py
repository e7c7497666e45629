"""ANOVA parts of a sampler's variance from sampled Fourier frequencies.

The frequencies that involve the axes u and no others make up the ANOVA part f_u, and the part of the
variance of points that are the same after any translation is

    c_u = Σ_{m: m_i ≠ 0 for i ∈ u only} |f_m|² ⟨|S_m|²⟩.

The sum has (2K)^|u| terms. It is estimated from a few: m is drawn with a probability q(m) = Π_{i∈u} q_1(m_i),
q_1(k) ∝ 1/k² up to K, and the mean of |f_m|² ⟨|S_m|²⟩ / q(m) is unbiased. |f_m|² of a function with
jumps or a boundary term falls like 1/m_i² on each axis, so that the terms are bounded.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mcspectra.core.checks import Array, as_integer
from mcspectra.core.errors import NoClosedForm, ParameterError
from mcspectra.core.results import dataset
from mcspectra.core.streams import RngLike, Stream
from mcspectra.estimators import AbstractEstimator, Estimator, as_estimator
from mcspectra.integrands import Integrand
from mcspectra.samplers import Sampler, as_sampler
from mcspectra.spectra.bases import fitting_basis
from mcspectra.spectra.closed_forms import closed_form_power
from mcspectra.spectra.listed import power_at

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["anova_spectrum"]

_MAX_DIMS = 64
_MAX_FREQUENCIES = 2**24  # in all
_MAX_WIDTH = 2**20
_BATCHES = 16  # independent of each other: their spread is the error


def anova_spectrum(
    estimator: AbstractEstimator | Integrand | str,
    sampler: Sampler | str,
    n: int,
    *,
    order: int = 2,
    frequencies: int = 1024,
    half_width: int = 4096,
    realizations: int = 64,
    rng: RngLike = 0,
) -> xr.Dataset:
    """Split the variance that a sampler leaves among subsets of the axes, by sampled frequencies.

    Parameters
    ----------
    estimator
        Of one integrand with exact Fourier coefficients and uniform points, in up to 64 dims.
    sampler, n
        Points that are the same after any translation: random, or with shift.
    order
        Subsets of up to so many axes, 1 to 3.
    frequencies
        Frequencies sampled of each subset, at least 32.
    half_width
        Largest |m_i|: what is beyond is left out.
    realizations
        Point sets in all, at least 32, where ⟨|S_m|²⟩ is not known in closed form.
    rng
        Seed (SPEC 7).

    Returns
    -------
    xarray.Dataset
        ``anova_variance`` c_u and ``anova_variance_se`` on dim subset, as `anova_variances` has them; the
        error is that of the mean of 16 independent batches of frequencies and sets. The attribute
        ``power`` says whether ⟨|S_m|²⟩ is exact.

    Raises
    ------
    NoClosedForm
        The coefficients are not exact, the points have a density, or their frequencies are
        correlated: `anova_variances` needs none of this.
    ParameterError, CountError
        A value is out of range, or the frequencies would not fit in memory.

    Examples
    --------
    >>> import mcspectra as mcs
    >>> f = mcs.integrand("gaussian(width=0.5)", dims=3)
    >>> parts = anova_spectrum(f, "latin-hypercube | shift", 64)
    >>> parts["anova_variance"].sizes["subset"]
    6
    >>> bool(parts["anova_variance"][0] < 0.1 * parts["anova_variance"][3])  # strata on each axis
    True
    """
    given = as_estimator(estimator, getattr(sampler, "dims", None))
    source = as_sampler(sampler, given.dims)
    n = source.check_count(n)
    given.check_sampler(source, n)
    f = _exact_integrand(given, source)
    dims = as_integer("dims", f.dims, least=1, most=_MAX_DIMS)
    order = min(as_integer("order", order, least=1, most=3), dims)
    subsets = [u for size in range(1, order + 1) for u in itertools.combinations(range(dims), size)]
    count = as_integer("frequencies", frequencies, least=2 * _BATCHES)
    if count * len(subsets) > _MAX_FREQUENCIES:
        raise ParameterError(
            f"{count} frequencies of {len(subsets)} subsets are more than {_MAX_FREQUENCIES:.3g} in all; "
            "ask for fewer frequencies or a lower order."
        )
    law = _Law.of(as_integer("half_width", half_width, least=1, most=_MAX_WIDTH))
    realizations = as_integer("realizations", realizations, least=2 * _BATCHES, most=10**9)
    stream = Stream.from_rng(rng)
    batches, source_of_power = [], ""
    for batch in range(_BATCHES):
        m, q = law.draw(subsets, dims, count // _BATCHES, stream.child(2 * batch))
        power, source_of_power = _power(
            source, n, m, realizations // _BATCHES, stream.child(2 * batch + 1)
        )
        energy = np.abs(f.fourier(m).reshape(len(m), -1)) ** 2
        terms = energy * (power / q)[:, None]
        batches.append(terms.reshape(len(subsets), -1, terms.shape[1]).mean(axis=1))
    found = np.stack(batches)
    se = found.std(axis=0, ddof=1) / math.sqrt(_BATCHES)
    names = ("subset", "channel") if f.channels else ("subset",)
    shape = (len(subsets), *([f.channels] if f.channels else []))
    return dataset(
        {
            "anova_variance": (names, found.mean(axis=0).reshape(shape)),
            "anova_variance_se": (names, se.reshape(shape)),
        },
        {
            "subset_label": ("subset", ["".join(f"x{i}" for i in u) for u in subsets]),
            "subset_size": ("subset", [len(u) for u in subsets]),
        },
        estimator=given.spec,
        sampler=source.spec,
        n=n,
        half_width=half_width,
        frequencies=frequencies,
        power=source_of_power,
        stream_key=f"{stream.key:#x}",
        seed=rng if isinstance(rng, int) else None,
    )


@dataclass(frozen=True)
class _Law:
    """Law of one component: ±k with probability ∝ 1/k², k = 1 … K."""

    cumulative: Array

    @staticmethod
    def of(half_width: int) -> _Law:
        weight = np.arange(1.0, half_width + 1) ** -2
        return _Law(np.cumsum(weight))

    def draw(
        self, subsets: list[tuple[int, ...]], dims: int, count: int, stream: Stream
    ) -> tuple[Array, Array]:
        """`count` frequencies of each subset, (U count, d), and their probabilities (U count,)."""
        m, q = np.zeros((len(subsets), count, dims)), np.ones((len(subsets), count))
        whole = self.cumulative[-1]
        for place, subset in enumerate(subsets):
            u = 2.0 * stream.uniforms(place, 1, count * len(subset)).reshape(count, -1)
            sign, u = np.where(u < 1.0, -1.0, 1.0), np.mod(u, 1.0)
            k = np.searchsorted(self.cumulative, u * whole, side="right") + 1.0
            k = np.minimum(k, len(self.cumulative))
            m[place][:, list(subset)] = sign * k
            q[place] = np.prod(0.5 / (k * k * whole), axis=1)
        return m.reshape(-1, dims), q.ravel()


def _exact_integrand(estimator: AbstractEstimator, sampler: Sampler) -> Integrand:
    """The integrand, if this route holds for it and for the sampler."""
    plain = isinstance(estimator, Estimator) and estimator.density is None
    if not plain or estimator.integrand.fourier_source != "exact":  # type: ignore[attr-defined]
        raise NoClosedForm(
            f"Sampled frequencies need exact Fourier coefficients and uniform points, which "
            f"{estimator.spec} does not have; use anova_variances."
        )
    if sampler.name != "random" and fitting_basis(sampler, 1) != "fourier":
        raise NoClosedForm(
            f"The frequencies of {sampler.spec} are correlated; add shift, or use anova_variances."
        )
    return estimator.integrand  # type: ignore[attr-defined, no-any-return]


def _power(
    sampler: Sampler, n: int, m: Array, realizations: int, stream: Stream
) -> tuple[Array, str]:
    """⟨|S_m|²⟩ at m ≠ 0, exact where it is known, and how it was found."""
    try:
        return closed_form_power(sampler, n, m), "closed form"
    except NoClosedForm:
        rng = np.random.SeedSequence(stream.key)
        found = power_at(sampler, n, m, realizations=realizations, rng=rng)
        return found["power"].to_numpy(), f"{_BATCHES * realizations} realisations"
