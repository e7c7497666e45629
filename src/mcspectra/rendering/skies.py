"""Our densities of directions for the environment of a scene, instead of Mitsuba's.

A density on [0,1)² becomes a density of directions, p(x)/(2π² sin πx_1) per steradian.
Here x_0 is φ/2π and x_1 is θ/π (see `mcspectra.core.environments`).
In Mitsuba's maps, the first row is at +y, and φ runs from −z to +x,
before the emitter's ``to_world`` is applied: ω = (sin θ sin φ, cos θ, −sin θ cos φ).
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any, final

import numpy as np

from mcspectra.core.checks import Array, as_integer
from mcspectra.core.display import shown
from mcspectra.core.errors import Parameter, ParameterError
from mcspectra.core.spec import parse
from mcspectra.densities import Density, EnvironmentDensity, as_density
from mcspectra.rendering.backend import LOCK, load_mitsuba
from mcspectra.rendering.scenes import Scene, emitter_name, find_emitter, load_scene, scene_name

__all__ = ["Sky", "environment_of", "rotation_of", "sky_pixels", "sky_technique"]

_ROWS = 512
_MOST_ROWS = 2**12
_ORTHONORMAL = 1e-4  # tolerance for products of several rotations in float32
_SMALLEST_SINE = 1e-12  # least sine near the poles, where the density per steradian is unbounded


@final
@dataclass(frozen=True, eq=False)
class Sky:
    """A density of directions toward an environment. `rotation` maps its frame to the world."""

    density: Density
    rotation: Array

    def sample(self, u: Array) -> tuple[Array, Array]:
        """Return world directions (M, 3) and densities per steradian (M,) for u (M, 2)."""
        x = self.density.sample(u)
        return _local(x) @ self.rotation.T, self._per_steradian(x)

    def pdf(self, directions: Array) -> Array:
        """Return the density per steradian (M,) of unit vectors (M, 3) in world space."""
        a, b, c = (directions @ self.rotation).T
        azimuth = np.arctan2(a, -c) / (2.0 * np.pi) % 1.0
        polar = np.arccos(np.clip(b, -1.0, 1.0)) / np.pi
        return self._per_steradian(np.stack([azimuth, polar], axis=-1))

    def _per_steradian(self, x: Array) -> Array:
        sine = np.maximum(np.sin(np.pi * x[:, 1]), _SMALLEST_SINE)
        return np.asarray(self.density.pdf(x) / (2.0 * np.pi**2 * sine))


def environment_of(scene: Scene, light: int | str | None = None) -> Any:
    """Return the environment emitter of a scene if it is the only used light.

    Raises
    ------
    ParameterError
        If the scene has no environment, or other lights are also used.
    """
    loaded = load_scene(scene)
    found = loaded.environment()
    if found is None:
        raise ParameterError(
            f"The scene {scene_name(scene)} has no environment to sample; add an <emitter> of type "
            "'envmap' or 'constant', or choose another strategy."
        )
    alone = len(loaded.emitters()) == 1
    if not (alone if light is None else find_emitter(scene, light).is_environment()):
        raise ParameterError(
            f"Directions are sampled toward the environment of {scene_name(scene)} only; give ",
            Parameter("light", emitter_name(found)),
            ", so that no other light is used.",
        )
    return found


def sky_pixels(scene: Scene, rows: int = _ROWS) -> Array:
    """Return the radiance of a scene's environment as a lat-long map, in the emitter's frame.

    Parameters
    ----------
    scene
        A scene: a name, a file or a dictionary, as in `load_scene`.
    rows
        Number of pixels along θ. There are twice as many pixels along φ.

    Returns
    -------
    ndarray
        Linear radiance (rows, 2 rows, 3) at pixel centers, for `EnvironmentDensity`.
        Mitsuba's maps have the centers of the first and last rows at the poles.
        The result is therefore interpolated between the pixels of Mitsuba's map.

    Raises
    ------
    ParameterError
        If the scene has no environment, or the number of rows is out of range.
    """
    height = as_integer("rows", rows, least=2, most=_MOST_ROWS)
    with LOCK:
        emitter = load_scene(scene).environment()
        if emitter is None:
            raise ParameterError(
                f"The scene {scene_name(scene)} has no environment; add an <emitter> of type "
                "'envmap' or 'constant'."
            )
        return _pixels(emitter, height)


def sky_technique(scene: Scene, density: Density | str | None, channel: str | int) -> Sky:
    """Bind a 2-D density, or the density of a spec, to the environment of a scene.

    A spec ``environment`` without a path means the scene's own environment, `sky_pixels`.
    If the density is None, this environment is interpolated bilinearly.
    The density is then proportional to `channel`, or to the luminance for ``"rgb"``.
    """
    if density is None:
        chosen = "luminance" if channel == "rgb" else channel
        density = f"environment(interpolation='bilinear', channel={chosen!r})"
    with LOCK:
        return _sky(load_scene(scene), scene_name(scene), density)


@functools.lru_cache(maxsize=32)
def _sky(loaded: Any, name: str, density: Density | str) -> Sky:
    made = as_density(density, 2) if isinstance(density, str) else density
    if isinstance(density, str) and isinstance(made, EnvironmentDensity):
        # Use the environment map of the scene, unless the spec names another map
        given = parse(density).arguments
        if not {"path", "values"} & set(given):
            made = EnvironmentDensity(values=_pixels(loaded.environment(), _ROWS), **given)
    if not isinstance(made, Density) or made.dims != 2 or made.primary_dims != 2:
        raise ParameterError(
            f"{shown(density)} is not a density in 2 dims; the environment of {name} needs one."
        )
    return Sky(made, rotation_of(loaded.environment()))


def _pixels(emitter: Any, rows: int) -> Array:
    """Return the emitter's radiance (rows, 2 rows, 3) at pixel centers."""
    x_1, x_0 = np.meshgrid(
        (np.arange(rows) + 0.5) / rows, (np.arange(2 * rows) + 0.5) / (2 * rows), indexing="ij"
    )
    x = np.stack([x_0.ravel(), x_1.ravel()], axis=-1)
    mitsuba = load_mitsuba()
    import drjit

    directions = _local(x) @ rotation_of(emitter).T
    far = drjit.zeros(mitsuba.SurfaceInteraction3f, len(directions))
    far.wi = -mitsuba.Vector3f(*(np.ascontiguousarray(c, np.float32) for c in directions.T))
    color = np.asarray(emitter.eval(far).numpy(), np.float64).T
    return np.broadcast_to(color, (len(directions), 3)).reshape(rows, 2 * rows, 3)


def rotation_of(emitter: Any) -> Array:
    """Return the rotation (3, 3) from an emitter's frame to the world; scaling is an error."""
    matrix = np.asarray(emitter.world_transform().matrix, np.float64).reshape(4, 4)[:3, :3]
    if not np.allclose(matrix.T @ matrix, np.eye(3), atol=_ORTHONORMAL):
        raise ParameterError(
            f"The to_world of the environment {shown(emitter_name(emitter))} is not a rotation "
            "or reflection, so it would be sampled wrongly; remove the scaling."
        )
    return matrix


def _local(x: Array) -> Array:
    """Return unit vectors (M, 3) of x (M, 2) in the emitter's own frame."""
    phi, theta = 2.0 * np.pi * x[:, 0], np.pi * x[:, 1]
    sine = np.sin(theta)
    return np.stack([sine * np.sin(phi), np.cos(theta), -sine * np.cos(phi)], axis=-1)
