"""Samples of each technique at a pixel: f/p and the densities of all techniques, as arrays.

A technique is ``"light"``, ``"bsdf"`` or a `Sky`; a light and skies are not combined, as both would
sample the environment. Where f is 0 only the technique that drew a direction is said to be able to:
a path without light belongs to nobody else, which keeps every p_t integrate to 1 where rays that are
blocked by a surface say nothing of the light behind it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, final

import numpy as np

from mcspectra.core.checks import Array, as_integer
from mcspectra.core.errors import ParameterError
from mcspectra.rendering.backend import LOCK, load_mitsuba
from mcspectra.rendering.receivers import Hit, film_hits, primary_hit
from mcspectra.rendering.scenes import Scene, find_emitter, load_scene, scene_name
from mcspectra.rendering.skies import Sky
from mcspectra.rendering.techniques import (
    LARGEST_SAMPLE,
    POWERS,
    follow_bsdf,
    heuristic_weight,
    look_at_sky,
    sample_bsdf,
    sample_light,
)

__all__ = ["CHUNK", "MOST_DIMS", "Draws", "Technique", "View", "check_channel"]

CHUNK = 2**20
"""Samples in one kernel: some 100 MiB of Dr.Jit's memory, and no faster if larger."""

MOST_DIMS = 5
_WITH_FILM = 4

Technique = str | Sky


@dataclass(frozen=True)
class Draws:
    """Values of M samples of one technique.

    Attributes
    ----------
    values
        f/p: float64 (M,) or (M, 3).
    pdfs
        Densities per steradian of all techniques, one of them that which drew: float64 (T, M).
    """

    values: Array
    pdfs: Array


@final
@dataclass(frozen=True)
class View:
    """A pixel of a scene, with the light that is used.

    Attributes
    ----------
    scene, x, y, light, channel, dims
        As for `Pixel`.
    """

    scene: Scene
    x: int
    y: int
    light: int | str | None
    channel: str | int
    dims: int

    @property
    def channels(self) -> int:
        """3 with ``channel="rgb"``, else 0."""
        return 3 if self.channel == "rgb" else 0

    @property
    def on_film(self) -> bool:
        """Whether the first two samples are a position in the pixel."""
        return self.dims >= _WITH_FILM

    def values(self, technique: Technique, u: Array, heuristic: str | None = None) -> Array:
        """f/p at u (..., dims), times the weight of a heuristic of `POWERS`: (...) or (..., 3)."""
        samples = u.reshape(-1, self.dims)
        out = np.empty((len(samples), 3) if self.channels else len(samples))
        for start in range(0, len(samples), CHUNK):
            part = slice(start, start + CHUNK)
            with LOCK:
                out[part] = self._values(technique, samples[part], heuristic)
        self._check_finite(out)
        return out.reshape((*u.shape[:-1], *out.shape[1:]))

    def draws(self, technique: Technique, u: Array, among: Sequence[Technique]) -> Draws:
        """f/p and the densities of all techniques at u (M, dims)."""
        found = []
        for start in range(0, len(u), CHUNK):
            with LOCK:
                found.append(self._draws(technique, u[start : start + CHUNK], among))
        if not found:
            return Draws(np.empty((0, 3) if self.channels else 0), np.empty((len(among), 0)))
        values = np.concatenate([d.values for d in found])
        self._check_finite(values)
        return Draws(values, np.concatenate([d.pdfs for d in found], axis=1))

    def _values(self, technique: Technique, u: Array, heuristic: str | None) -> Array:
        if isinstance(technique, Sky):
            return self._look(technique, u)[0]
        hit, emitter, samples, extra = self._inputs(u)
        sample = sample_light if technique == "light" else sample_bsdf
        value, own, other = sample(hit, emitter, samples, extra, hit.active)
        if heuristic is not None:
            value *= heuristic_weight(own, other, POWERS[heuristic])
        return _numbers(value, self.channel, len(u))

    def _draws(self, technique: Technique, u: Array, among: Sequence[Technique]) -> Draws:
        if isinstance(technique, Sky):
            values, own, bsdf, directions = self._look(technique, u)
            pdfs: dict[Technique, Array] = {technique: own, "bsdf": bsdf}
        else:
            values, pdfs, directions = self._sample(technique, u, among)
        lit = values != 0.0 if values.ndim == 1 else (values != 0.0).any(axis=1)
        rows = np.zeros((len(among), len(u)))
        for row, other in zip(rows, among, strict=True):
            if isinstance(other, Sky) and other is not technique:
                pdfs[other] = other.pdf(directions)
            row[:] = pdfs[other] if other == technique else np.where(lit, pdfs[other], 0.0)
        return Draws(values, rows)

    def _sample(
        self, technique: str, u: Array, among: Sequence[Technique]
    ) -> tuple[Array, dict[Technique, Array], Array]:
        """f/p, densities of light and BSDF, and directions (M, 3) if `among` has skies."""
        import drjit

        hit, emitter, samples, extra = self._inputs(u)
        directions = np.empty((0, 3))
        if technique == "light":
            value, light, bsdf = sample_light(hit, emitter, samples, extra, hit.active)
            drjit.eval(value, light, bsdf)  # one kernel, not one for each
        else:
            value, bsdf, light, towards = follow_bsdf(hit, emitter, samples, extra, hit.active)
            drjit.eval(value, light, bsdf, towards)
            if any(isinstance(t, Sky) for t in among):
                directions = np.asarray(_spread(towards.numpy().T, (len(u), 3)), np.float64)
        pdfs: dict[Technique, Array] = {
            "light": _spread(light.numpy(), len(u)),
            "bsdf": _spread(bsdf.numpy(), len(u)),
        }
        return np.asarray(_numbers(value, self.channel, len(u)), np.float64), pdfs, directions

    def _look(self, sky: Sky, u: Array) -> tuple[Array, Array, Array, Array]:
        """f/p, the density of a sky and of the BSDF, and directions (M, 3)."""
        import drjit

        mitsuba, hit = load_mitsuba(), self._hit(u)
        emitter = load_scene(self.scene).environment()
        where = u[:, self._first : self._first + 2]
        directions, own = sky.sample(where)
        towards = mitsuba.Vector3f(*(np.ascontiguousarray(c, np.float32) for c in directions.T))
        value, bsdf = look_at_sky(hit, emitter, towards, hit.active)
        drjit.eval(value, bsdf)
        f = np.asarray(_numbers(value, self.channel, len(u)), np.float64)
        scaled = own if f.ndim == 1 else own[:, None]
        over = np.divide(f, scaled, out=np.zeros_like(f), where=scaled > 0)
        return over, own, _spread(bsdf.numpy(), len(u)), directions

    def _inputs(self, u: Array) -> tuple[Hit, Any, Any, Any]:
        """What is hit, the light that counts, and the kernel's samples of u (M, dims)."""
        mitsuba, hit, at = load_mitsuba(), self._hit(u), self._first
        columns = [mitsuba.Float(_as_samples(c)) for c in u[:, at:].T]
        emitter = None if self.light is None else find_emitter(self.scene, self.light)
        extra = columns[2] if len(columns) > 2 else None
        return hit, emitter, mitsuba.Point2f(*columns[:2]), extra

    def _hit(self, u: Array) -> Hit:
        scene = load_scene(self.scene)
        if self._first:
            return film_hits(scene, self.x, self.y, np.minimum(u[:, :2], LARGEST_SAMPLE))
        return primary_hit(scene, self.x, self.y)

    @property
    def _first(self) -> int:
        """The column at which the direction's two samples start."""
        return 2 if self.on_film else 0

    def _check_finite(self, values: Array) -> None:
        if not np.isfinite(values.sum()):  # a fraction of the time of looking at each
            bad = values.size - int(np.count_nonzero(np.isfinite(values)))
            raise ParameterError(
                f"Mitsuba gave {bad} NaN or infinite values at pixel ({self.x}, {self.y}) of "
                f"{scene_name(self.scene)}; check the scene's materials and lights."
            )


def check_channel(channel: object, names: Sequence[str] = ("luminance", "rgb")) -> str | int:
    """Return a channel, one of these names or 0, 1 or 2; anything else is a ParameterError."""
    if isinstance(channel, str) and channel in names:
        return str(channel)
    try:
        return as_integer("channel", channel, least=0, most=2)
    except ParameterError:
        allowed = ", ".join(map(repr, names))
        raise ParameterError(f"channel is {channel!r}; give {allowed}, 0, 1 or 2.") from None


def _as_samples(u: Array) -> Array:
    """Return contiguous float32 samples in [0,1), never rounded up to 1."""
    samples = np.array(u, np.float32, order="C")
    return np.minimum(samples, np.float32(LARGEST_SAMPLE), out=samples)


def _numbers(color: Any, channel: str | int, count: int) -> Array:
    """Copy a color to an array (count,) or (count, 3)."""
    if channel == "rgb":
        return _spread(color.numpy().T, (count, 3))
    chosen = load_mitsuba().luminance(color) if channel == "luminance" else color[channel]
    return _spread(chosen.numpy(), count)


def _spread(found: Any, shape: int | tuple[int, ...]) -> Array:
    """An array of a shape: Dr.Jit keeps constants at width 1."""
    return np.broadcast_to(np.asarray(found), shape)
