"""One channel of an integrand with several, or their luminance, as a scalar integrand."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, final

import numpy as np

from mcspectra.core.checks import Array, as_integer
from mcspectra.core.errors import ParameterError
from mcspectra.core.images import REC709
from mcspectra.integrands.base import Integrand

__all__ = ["Channel"]


@final
@dataclass(frozen=True, kw_only=True)
class Channel(Integrand):
    """A scalar view of an integrand with channels.

    Attributes
    ----------
    integrand
        The integrand f, with at least one channel.
    channel
        Number of the channel, or ``"luminance"`` (Rec. 709; of three channels).

    Raises
    ------
    ParameterError
        f is scalar, or has no such channel, or not three for the luminance.
    """

    name: ClassVar[str] = "channel"
    integrand: Integrand
    channel: int | str = "luminance"

    def __post_init__(self) -> None:
        channels = self.integrand.channels
        if not channels:
            raise ParameterError(f"{self.integrand.spec} is scalar: it has no channels to choose.")
        if self.channel != "luminance":
            chosen = as_integer("channel", self.channel, least=0, most=channels - 1)
            object.__setattr__(self, "channel", chosen)
        elif channels != len(REC709):
            raise ParameterError(
                f"{self.integrand.spec} has {channels} channels, luminance needs "
                f"{len(REC709)}; give the number of a channel."
            )

    @property
    def spec(self) -> str:
        """``f[channel]``."""
        return f"{self.integrand.spec}[{self.channel}]"

    @property
    def dims(self) -> int:  # type: ignore[override]
        """Number of dims of f."""
        return self.integrand.dims

    @property
    def breaks(self) -> tuple[tuple[float, ...], ...]:
        """Breaks of f."""
        return self.integrand.breaks

    def box_moments(self, lo: Array, hi: Array) -> tuple[Array, Array] | None:
        """Means of f for a single channel; unknown for the luminance, which needs products."""
        found = self.integrand.box_moments(lo, hi)
        if found is None or self.channel == "luminance":
            return None
        return self._of(found[0]), self._of(found[1])

    def _of(self, values: Array) -> Array:
        if isinstance(self.channel, str):
            return np.asarray(values @ REC709)
        return np.asarray(values[..., self.channel])

    def _evaluate(self, x: Array) -> Array:
        return self._of(self.integrand._evaluate(x))

    def _integral(self) -> Any:
        exact = self.integrand._integral()
        return None if exact is None else float(self._of(np.asarray(exact)))

    def _fourier(self, m: Array) -> Array | None:
        exact = self.integrand._fourier(m)
        return None if exact is None else self._of(exact)
