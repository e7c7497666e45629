"""The picture of Veach's scene, and the spec of the pixel that is clicked."""

from __future__ import annotations

import numpy as np

from mcspectra.app.specs import TECHNIQUES
from mcspectra.core.cache import cached_array
from mcspectra.core.checks import Array, as_choice, as_integer

__all__ = ["HEIGHT", "STRATEGIES", "WIDTH", "pixel_spec", "veach_picture"]

WIDTH, HEIGHT = 192, 128
STRATEGIES = ("light", "bsdf", "balance", "power", "mis-light", "mis-bsdf")
_HEURISTICS = ("balance", "power")  # of the sum of light and BSDF sampling
_SCENE = f"veach(width={WIDTH}, height={HEIGHT})"
_SPP = 64


def pixel_spec(x: int, y: int, strategy: str = "light") -> str:
    """Return the spec of the integrand of a pixel, counted from the left and from the top.

    With ``"balance"`` or ``"power"`` it is the sum of light and BSDF sampling, weighted by that
    heuristic; ``"mis-light"`` and ``"mis-bsdf"`` are its terms for the balance heuristic.

    Raises
    ------
    ParameterError
        It lies outside the picture, or there is no such strategy.
    """
    x = as_integer("x of the pixel", x, least=0, most=WIDTH - 1)
    y = as_integer("y of the pixel", y, least=0, most=HEIGHT - 1)
    as_choice("strategy", strategy, STRATEGIES)
    where = f"scene='{_SCENE}', x={x}, y={y}"
    if strategy not in _HEURISTICS:
        return f"pixel({where}, strategy='{strategy}')"
    parts = [
        f"pixel({where}, strategy='mis-{name}', heuristic='{strategy}')"
        for name in ("light", "bsdf")
    ]
    return f"{TECHNIQUES}(integrands={parts!r})"


def veach_picture() -> Array:
    """Return the scene as 8-bit RGBA packed into uint32, (HEIGHT, WIDTH), bottom row first.

    Raises
    ------
    MissingDependency
        Mitsuba or LLVM is missing.
    """
    linear = cached_array(f"explorer {_SCENE} {_SPP} 1", _rendered)
    encoded = np.where(
        linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055
    )
    rgba = np.full((HEIGHT, WIDTH, 4), 255, np.uint8)
    rgba[..., :3] = np.rint(255 * np.clip(encoded, 0.0, 1.0))
    return np.ascontiguousarray(rgba[::-1]).view(np.uint32)[..., 0]


def _rendered() -> Array:
    from mcspectra.rendering.image import render

    return np.asarray(render(_SCENE, spp=_SPP)["image"].to_numpy(), np.float64)
