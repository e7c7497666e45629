"""Multiple importance sampling at a pixel, by every heuristic, any techniques and any counts.

The techniques share directions but no warp: each has a unit cube of its own, so that there is no domain
view, and densities are per steradian. A heuristic that knows f asks random pilot points, which the
estimate does not use; ``optimal(samples=…, seed=…)`` says how many and which.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, final

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.errors import ParameterError
from mcspectra.core.streams import Stream
from mcspectra.densities import Density
from mcspectra.estimators.base import AbstractEstimator, check_counts
from mcspectra.estimators.heuristics import Heuristic, Pilot, as_heuristic
from mcspectra.estimators.importance import Estimator, scale
from mcspectra.estimators.sets import check_sets
from mcspectra.integrands import Integrand
from mcspectra.integrands.base import Estimate
from mcspectra.rendering.pixel import (
    ENVIRONMENT,
    SOURCE,
    Draws,
    Pixel,
    Technique,
    View,
    check_view,
    mean_of_points,
)
from mcspectra.rendering.scenes import Scene, as_scene, scene_name
from mcspectra.rendering.skies import environment_of, sky_technique

__all__ = ["PixelMIS", "pixel_mis"]

_BY_NAME = ("light", "bsdf")


@final
class PixelMIS(AbstractEstimator):
    """Multiple importance sampling of a pixel's direct illumination; made by `pixel_mis`.

    Attributes
    ----------
    techniques
        ``"light"``, ``"bsdf"`` and densities, as they were given.
    heuristic
        Spec of the heuristic.
    shares
        Counts of the techniques, times the factors of a heuristic that knows f.
    control
        α_t (T,) or (T, 3) where the weights have a control variate (``optimal``), else None.
    """

    def __init__(
        self,
        view: View,
        techniques: tuple[Density | str, ...],
        *,
        heuristic: Heuristic | str,
        counts: Sequence[int] | None,
        sets: str,
    ) -> None:
        self.view, self.techniques = view, techniques
        self._bound = tuple(_bound(view, t) for t in techniques)
        self._weights = as_heuristic(heuristic)
        self.heuristic = self._weights.spec
        self.counts = check_counts(
            [1] * len(techniques) if counts is None else counts, len(techniques)
        )
        self.sets = check_sets(sets, self.counts)
        pilot = _PixelPilot(self, np.asarray(self.counts, np.float64))
        self.shares, self.control = self._weights.adapt(pilot)
        self._integrands = tuple(_Weighted(self, t) for t in range(len(self.counts)))

    def __repr__(self) -> str:
        return f"PixelMIS({self.spec})"

    @property
    def spec(self) -> str:
        """``pixel(…) / heuristic[techniques]``."""
        parts = zip(self.counts, range(len(self.counts)), strict=True)
        shown = [
            f"{c}×{self.technique_name(t)}" if c > 1 else self.technique_name(t) for c, t in parts
        ]
        v = self.view
        kept = [f"scene={scene_name(v.scene)}, x={v.x}, y={v.y}"]
        kept += [] if v.light is None else [f"light={v.light!r}"]
        kept += [] if v.channel == "luminance" else [f"channel={v.channel!r}"]
        return f"pixel({', '.join(kept)}) / {self.heuristic}[{', '.join(shown)}]{self.sets_label}"

    @property
    def dims(self) -> int:
        """Number of dims of every technique."""
        return self.view.dims

    @property
    def channels(self) -> int:
        """3 with ``channel="rgb"``, else 0."""
        return self.view.channels

    @property
    def integral(self) -> Any:
        """Σ_t ∫ g_t."""
        return sum(self.primary_integrand(t).integral for t in range(len(self.counts)))

    @property
    def integral_source(self) -> str:
        """The means behind the integrals of the techniques."""
        return SOURCE

    @property
    def domain_integrand(self) -> None:
        """None: the techniques share directions, but no unit cube."""
        return

    def primary_integrand(self, technique: int) -> Integrand:
        """g_t, the same object each time: it keeps what was computed for it."""
        return self._integrands[technique]

    def primary_values(self, technique: int, u: Array) -> Array:
        """w_t f/p_t, which with optimal weights is α_t + (f − Σ α_s p_s) w_t/p_t."""
        flat = u.reshape(-1, self.dims)
        values = self._weigh(technique, self.draws(technique, flat))
        return values.reshape((*u.shape[:-1], *values.shape[1:]))

    def draws(self, technique: int, u: Array) -> Draws:
        """f/p_t and the densities of all techniques at u (M, dims)."""
        return self.view.draws(self._bound[technique], u, self._bound)

    def with_heuristic(self, heuristic: str) -> PixelMIS:
        """The same techniques, counts and sets with the heuristic of this spec."""
        return PixelMIS(
            self.view, self.techniques, heuristic=heuristic, counts=self.counts, sets=self.sets
        )

    def alone(self, technique: int) -> Estimator:
        """One technique without the others."""
        given = self.techniques[technique]
        if isinstance(given, str) and given in (*_BY_NAME, ENVIRONMENT):
            return Estimator(Pixel(strategy=given, **vars(self.view)))
        return Estimator(Pixel(strategy=ENVIRONMENT, density=given, **vars(self.view)))

    def technique_name(self, technique: int) -> str:
        """``light``, ``bsdf`` or the spec of a density."""
        given = self.techniques[technique]
        return given.spec if isinstance(given, Density) else given

    def _weigh(self, technique: int, draws: Draws) -> Array:
        """g_t from what a technique drew: (M,) or (M, 3)."""
        own = draws.pdfs[technique]
        q = np.asarray(self.shares)[:, None] * draws.pdfs
        over = self.shares[technique] * self._weights.ratio(q, technique)  # w_t/p_t
        if self.control is None:
            return scale(draws.values, own * over)
        left = scale(draws.values, own) - draws.pdfs.T @ self.control
        # A sample that was lost, below the surface say, is no sample of p_t: nothing is added.
        sampled = own > 0.0 if left.ndim == 1 else (own > 0.0)[:, None]
        return np.where(sampled, self.control[technique] + scale(left, over), 0.0)


@final
@dataclass(frozen=True, eq=False)
class _Weighted(Integrand):
    """g_t of a pixel's multiple importance sampling."""

    name: ClassVar[str] = "pixel-technique"
    costly: ClassVar[bool] = True
    estimator: PixelMIS
    technique: int

    @property
    def dims(self) -> int:  # type: ignore[override]
        """Number of dims of the technique."""
        return self.estimator.dims

    @property
    def channels(self) -> int:  # type: ignore[override]
        """Channels of the pixel."""
        return self.estimator.channels

    @property
    def spec(self) -> str:
        """Text for messages."""
        return f"{self.estimator.technique_name(self.technique)} of {self.estimator.spec}"

    @property
    def integral_source(self) -> str:
        """As for `Pixel`."""
        return SOURCE

    def _estimated_integral(self) -> Estimate:
        return mean_of_points(self)

    def _evaluate(self, x: Array) -> Array:
        return self.estimator.primary_values(self.technique, x)


@final
@dataclass(frozen=True, eq=False)
class _PixelPilot(Pilot):
    """A pilot whose points are rows of T densities and the channels of f."""

    estimator: PixelMIS
    shares: Array

    @property
    def channels(self) -> int:  # type: ignore[override]
        """Channels of the pixel."""
        return self.estimator.channels

    def points(self, technique: int, count: int, seed: int) -> Array:
        """Densities and f of random samples of a technique: (count, T + C)."""
        stream, dims = Stream.from_rng(seed).child(technique), self.estimator.dims
        drawn = self.estimator.draws(
            technique, stream.uniforms(0, 1, count * dims).reshape(-1, dims)
        )
        f = scale(drawn.values, drawn.pdfs[technique]).reshape(count, -1)
        return np.concatenate([drawn.pdfs.T, f], axis=1)

    def pdfs(self, x: Array) -> Array:
        """p_t: (T, k)."""
        return x[:, : len(self.shares)].T

    def values(self, x: Array) -> Array:
        """f: (k, C)."""
        return x[:, len(self.shares) :]


def pixel_mis(
    scene: Scene,
    x: int,
    y: int,
    *,
    heuristic: Heuristic | str = "balance",
    techniques: Sequence[Density | str] = _BY_NAME,
    counts: Sequence[int] | None = None,
    sets: str = "independent",
    light: int | str | None = None,
    channel: str | int = "luminance",
    dims: int = 2,
) -> PixelMIS:
    """Make multiple importance sampling of one pixel.

    Parameters
    ----------
    scene, x, y, light, channel, dims
        As for `Pixel`.
    heuristic
        A name or spec of `mcspectra.estimators.HEURISTICS`, or an object. ``optimal`` and
        ``variance-aware`` use a pilot of 4096 random samples with seed 0 unless their spec says
        otherwise; a quadrature is not possible here.
    techniques
        ``"light"``, ``"bsdf"``, and densities for the environment as for `Pixel`, or
        ``"environment"`` for the scene's own map; any number of densities, but not together
        with ``"light"``.
    counts
        Samples of each technique as multiples of n; the same for all by default.
    sets
        How the points of the techniques belong together: `mcspectra.estimators.sets`.

    Raises
    ------
    ParameterError
        As for `Pixel`; or techniques, counts or heuristic are not as above.

    Examples
    --------
    >>> import mcspectra as mcs
    >>> mis = mcs.rendering.pixel_mis("veach", 568, 100, light="light-3", heuristic="power")
    >>> mis.technique_name(1)
    'bsdf'
    """
    given = tuple(techniques) if isinstance(techniques, list | tuple) else ()
    if not given or not all(isinstance(t, str | Density) for t in given):
        raise ParameterError(
            f"techniques is {techniques!r:.80}; give a list of 'light', 'bsdf', 'environment' and "
            "densities."
        )
    repeated = sum(t == "light" for t in given) > 1 or sum(t == "bsdf" for t in given) > 1
    if repeated or ("light" in given and any(t not in _BY_NAME for t in given)):
        raise ParameterError(
            f"techniques is {techniques!r:.80}; give 'light' and 'bsdf' at most once, and densities "
            "without 'light', which samples the environment too."
        )
    asked = View(as_scene(scene), x, y, light, channel, dims)
    view = check_view(asked, bsdf="bsdf" in given)
    return PixelMIS(view, given, heuristic=heuristic, counts=counts, sets=sets)


def _bound(view: View, technique: Density | str) -> Technique:
    """The technique as `View` knows it."""
    if isinstance(technique, str) and technique in _BY_NAME:
        return technique
    environment_of(view.scene, view.light)
    own = None if technique == ENVIRONMENT else technique
    return sky_technique(view.scene, own, view.channel)
