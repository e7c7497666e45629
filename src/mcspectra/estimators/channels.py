"""Color: importance sampling with one density for each channel, or with one density for all.

If all channels share one density p, such as the luminance, then f_c/p may jump where p jumps.
With a separate density p_c for each channel, f_c/p_c jumps only where f_c itself jumps.
The rate of channel c then depends only on f_c. `channel_estimators` makes four estimators:

``one``
    All channels use the points of one density, such as the luminance. It evaluates f n times.
``own``
    Channel c uses n independent points of its own density p_c. This takes C n evaluations.
``shared``
    One set of primary points is warped by each density, which also takes C n evaluations.
    The errors of the channels are correlated, so the noise is less colored.
``mis``
    All channels use all points of all densities by the balance heuristic, with C n evaluations.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import final

import numpy as np

from mcspectra.core.checks import Array, as_choice
from mcspectra.core.errors import ParameterError
from mcspectra.core.streams import Stream
from mcspectra.densities import Density
from mcspectra.densities.base import divide_by_density
from mcspectra.estimators.base import (
    AbstractEstimator,
    DomainEstimator,
    PrimaryIntegrand,
    carried_breaks,
)
from mcspectra.estimators.importance import Estimator, as_densities, check_support, known_dims
from mcspectra.estimators.mis import MultipleImportance
from mcspectra.integrands import Integrand, as_integrand
from mcspectra.integrands.base import Breaks, Channel
from mcspectra.samplers import Sampler

__all__ = ["ChannelSampling", "channel_estimators"]

_SETS = ("independent", "shared")


@final
class ChannelSampling(DomainEstimator):
    """An estimator with one density for each channel, I_c = (1/n) Σ_k f_c(x_ck)/p_c(x_ck).

    Each channel is a technique. Analyses use primary space only, because there is no common domain:
    the points of different channels have different spectra.

    Parameters
    ----------
    integrand
        An integrand f with C channels, or its spec string.
    densities
        Densities p_c, one for each channel, or their spec strings.
    sets
        ``"independent"`` draws points for each channel. ``"shared"`` warps one set for all.
    dims
        Number of dims; needed for spec strings without ``dims``.

    Raises
    ------
    DensityError
        If a density is zero at points where its channel of f is not zero.
    ParameterError
        If f is scalar, or if the numbers of densities and channels differ.
        If the dims differ, or if `sets` is unknown.
    """

    def __init__(
        self,
        integrand: Integrand | str,
        densities: Sequence[Density | str],
        *,
        sets: str = "independent",
        dims: int | None = None,
    ) -> None:
        self.integrand, self.densities = _matched(integrand, densities, dims)
        self.sets = as_choice("sets", sets, _SETS)
        self.counts = (1,) * len(self.densities)
        for channel, density in enumerate(self.densities):
            check_support(Channel(integrand=self.integrand, channel=channel), [density])

    @property
    def spec(self) -> str:
        """Text of the form ``f / sets[densities]``."""
        shown = ", ".join(density.spec for density in self.densities)
        return f"{self.integrand.spec} / channels, {self.sets}[{shown}]"

    @property
    def domain_integrand(self) -> None:
        """Always None, because each channel of the integrand has its own weighted points."""
        return

    def draw(self, sampler: Sampler, n: int, stream: Stream, first: int, count: int) -> list[Array]:
        """Draw a point set for each channel, or one point set for all channels."""
        if self.sets == "independent":
            return super().draw(sampler, n, stream, first, count)
        return [sampler.draw_stream(n, stream, first, count)] * len(self.densities)

    def _primary(self, technique: int) -> Integrand:
        """Return g_c(u) = f_c(T_c(u))/p_c(T_c(u)) in channel c, and 0 in all other channels."""
        return PrimaryIntegrand(self, technique, self.integrand, self.densities[technique])

    def primary_breaks(self, technique: int) -> Breaks:
        return carried_breaks(self.integrand, self.densities[technique])

    def primary_values(self, technique: int, u: Array) -> Array:
        """Return g_c(u) as (..., channels), with 0 in all channels except c."""
        x = self.densities[technique].sample(u)
        values = np.zeros((*u.shape[:-1], self.channels))
        own = self.integrand(x)[..., technique]
        pdf = self.densities[technique].pdf(x)
        values[..., technique] = divide_by_density(own, pdf, x, self.spec)
        return values


def channel_estimators(
    integrand: Integrand | str,
    densities: Sequence[Density | str],
    one: Density | str | None = None,
    *,
    dims: int | None = None,
) -> dict[str, AbstractEstimator]:
    """Make estimators of a color integrand, which `mcspectra.convergence` can compare.

    Parameters
    ----------
    integrand
        An integrand f with C channels, or its spec string.
    densities
        One density for each channel.
    one
        A density for all channels, such as the luminance. None omits the estimator ``one``.
    dims
        Number of dims; needed for spec strings without ``dims``.

    Returns
    -------
    dict
        The estimators ``one`` (if given), ``own``, ``shared`` and ``mis``, described in the module.
        With n points per technique, ``one`` evaluates f n times, each other estimator C n times.
        Therefore compare the estimators at equal numbers of evaluations, Σ counts · n.

    Examples
    --------
    >>> import mcspectra as mcs
    >>> f = mcs.Integrand.from_function(
    ...     lambda x: np.concatenate([1 + x, 2 - x], axis=-1), dims=1, integral=[1.5, 1.5]
    ... )
    >>> channels = ["linear(slope=0.5)", "linear(slope=-0.5)"]
    >>> ways = mcs.estimators.channel_estimators(f, channels, "uniform")
    >>> list(ways)
    ['one', 'own', 'shared', 'mis']
    """
    f, found = _matched(integrand, densities, dims)
    ways: dict[str, AbstractEstimator] = {} if one is None else {"one": Estimator(f, one)}
    for name, sets in (("own", "independent"), ("shared", "shared")):
        ways[name] = ChannelSampling(f, found, sets=sets)
    ways["mis"] = MultipleImportance(f, found)
    return ways


def _matched(
    integrand: Integrand | str, densities: Sequence[Density | str], dims: int | None
) -> tuple[Integrand, tuple[Density, ...]]:
    """Return an estimator of the integrand with a density for each channel."""
    parts = densities if isinstance(densities, list | tuple) else ()
    f = as_integrand(integrand, known_dims(dims, integrand, *parts))
    if parts and f.channels != len(parts):
        channels = f"{f.channels} channels" if f.channels else "no channels: it is scalar"
        raise ParameterError(
            f"{f.spec} has {channels}, but {len(parts)} densities were given; "
            "give one for each channel."
        )
    return f, as_densities(densities, f.dims, ", one for each channel")
