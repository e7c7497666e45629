"""A pixel's direct illumination as an integrand on the unit cube (Mitsuba 3, ``llvm_ad_rgb``).

Method
------
The camera ray through the pixel's centre fixes one surface point, once and for all. Its direct
illumination is ∫ f_r L_e V cos over directions, and each strategy is the primary-space integrand
g(u) = f/p at the direction that is made of u in [0,1)²: ``light`` samples a light, ``bsdf`` the
BSDF, ``environment`` a density of ours (`skies`). With ``mis-light`` and ``mis-bsdf`` each is
weighted by a heuristic [VeachGuibas1995]_ for equal numbers of samples, so that their sum, with
independent points, is multiple importance sampling; `pixel_mis` has all heuristics, any counts and
any techniques. Light that reaches the camera directly is not part of it.

Mitsuba computes in float32: values carry relative errors of about 1e-7, and averages of them are
taken in float64. One light alone is the clean experiment. With all lights Mitsuba selects one
(uniformly, or by ``sampling_weight``) by stretching the first coordinate, which cuts the square
into strips and adds discontinuities; a selecting coordinate takes that out. The columns of u:

===========  ==================================================================================
``dims=2``   direction
``dims=3``   direction; selection of a light, or of a lobe of the BSDF
``dims=4``   position in the pixel, from its upper left corner; direction
``dims=5``   position; direction; selection
===========  ==================================================================================

With positions the integral is the mean over the pixel; it is 0 where a ray leaves the scene or sees
a light.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, final

from mcspectra.core.checks import Array, as_choice, as_integer
from mcspectra.core.errors import ParameterError
from mcspectra.densities import Density
from mcspectra.integrands.base import Estimate, Integrand
from mcspectra.rendering._pixel_integral import SOURCE, mean_of_points
from mcspectra.rendering.backend import LOCK
from mcspectra.rendering.draws import MOST_DIMS, Technique, View, check_channel
from mcspectra.rendering.receivers import (
    check_film_receivers,
    check_pixel,
    check_receiver,
    check_single_lobe,
    primary_hit,
)
from mcspectra.rendering.scene_checks import check_lights
from mcspectra.rendering.scenes import Scene, as_scene, load_scene
from mcspectra.rendering.skies import environment_of, sky_technique
from mcspectra.rendering.techniques import POWERS

__all__ = ["ENVIRONMENT", "STRATEGIES", "Pixel", "check_view", "describe_pixel", "pixel_strategies"]

STRATEGIES = ("light", "bsdf", "mis-light", "mis-bsdf")
"""Those of any scene."""

ENVIRONMENT = "environment"
"""The strategy for scenes with an environment."""


@final
@dataclass(frozen=True, kw_only=True)
class Pixel(Integrand):
    """Direct illumination seen in one pixel of a scene, by light or BSDF sampling.

    Parameters
    ----------
    scene
        A scene's name, the path of a Mitsuba XML file or a Mitsuba dictionary (see `load_scene`).
    x, y
        Pixel, counted from the left and from the top. The ray goes through its centre if ``dims``
        is below 4.
    strategy
        ``"light"``, ``"bsdf"``, or their shares of multiple importance sampling, ``"mis-light"``
        and ``"mis-bsdf"``, which belong together; ``"environment"`` samples directions by `density`.
    light
        Index or name of the only light to use; the others are dark but still occlude. All
        lights by default.
    heuristic
        ``"balance"`` or ``"power"`` (β = 2), for the two ``mis-`` strategies.
    channel
        ``"luminance"`` (Rec. 709), 0, 1 or 2 for red, green or blue, or ``"rgb"`` for all three.
    dims
        2; 3 to leave the choice of a light, or of a lobe of the BSDF, to a third coordinate; 4 or 5
        for the same with positions in the pixel first.
    density
        For ``"environment"``: a `Density` in 2 dims over the square of latitude and longitude, or
        its spec, such as ``"environment(interpolation='bilinear', channel=0)"``, which without a
        ``path`` means the scene's own map; by default that one, bilinear, by `channel`. Where the
        density is 0 nothing is sampled: one with compensation is for `pixel_mis`.

    Raises
    ------
    ParameterError
        The pixel is outside the film, sees nothing or a light; its BSDF or a light that counts is
        a delta function; its BSDF needs one dim more; there is no such light; lights other than
        the environment count with ``"environment"``; or a parameter is not one of those allowed.
    MissingDependency
        Mitsuba or LLVM is missing.
    """

    name: ClassVar[str] = "pixel"
    costly: ClassVar[bool] = True
    scene: Any = "veach"
    x: int
    y: int
    strategy: str = "light"
    light: int | str | None = None
    heuristic: str = "balance"
    channel: str | int = "luminance"
    dims: int = 2
    density: Density | str | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "scene", as_scene(self.scene))
        as_choice("strategy", self.strategy, (*STRATEGIES, ENVIRONMENT))
        as_choice("heuristic", self.heuristic, tuple(POWERS))
        if self.density is not None and self.strategy != ENVIRONMENT:
            raise ParameterError(
                f"density is for strategy='environment', not for {self.strategy!r}; leave it out."
            )
        view = check_view(self._view, bsdf=self.strategy.endswith("bsdf"))
        for name in ("x", "y", "channel", "dims"):  # NumPy's integers become Python's
            object.__setattr__(self, name, getattr(view, name))
        self._technique()

    @property
    def channels(self) -> int:  # type: ignore[override]
        """3 with ``channel="rgb"``, else 0."""
        return self._view.channels

    @property
    def integral_source(self) -> str:
        """The means behind `integral`; `integral_accuracy` has their standard error."""
        return SOURCE

    def _estimated_integral(self) -> Estimate:
        return mean_of_points(self)

    def _evaluate(self, x: Array) -> Array:
        heuristic = self.heuristic if self.strategy.startswith("mis") else None
        return self._view.values(self._technique(), x, heuristic)

    @property
    def _view(self) -> View:
        return View(self.scene, self.x, self.y, self.light, self.channel, self.dims)

    def _technique(self) -> Technique:
        if self.strategy != ENVIRONMENT:
            return self.strategy.removeprefix("mis-")
        environment_of(self.scene, self.light)
        return sky_technique(self.scene, self.density, self.channel)


def pixel_strategies(
    scene: Scene,
    x: int,
    y: int,
    *,
    light: int | str | None = None,
    heuristic: str = "balance",
    channel: str | int = "luminance",
    dims: int = 2,
) -> dict[str, Integrand]:
    """Return all strategies of a pixel by name; parameters and errors as those of `Pixel`."""
    return {
        strategy: Pixel(
            scene=scene,
            x=x,
            y=y,
            strategy=strategy,
            light=light,
            heuristic=heuristic,
            channel=channel,
            dims=dims,
        )
        for strategy in STRATEGIES
    }


def check_view(view: View, *, bsdf: bool) -> View:
    """Return a pixel with its numbers as Python integers, if it can be sampled.

    Parameters
    ----------
    view
        The pixel.
    bsdf
        Whether its BSDF will be, which may need a dim more.

    Raises
    ------
    ParameterError
        It cannot be sampled, as for `Pixel`.
    """
    channel = check_channel(view.channel)
    dims = as_integer("dims of a pixel", view.dims, least=2, most=MOST_DIMS)
    single_lobe = bsdf and dims % 2 == 0
    with LOCK:
        x, y = check_pixel(view.scene, view.x, view.y)
        check_lights(view.scene, view.light)
        checked = View(view.scene, x, y, view.light, channel, dims)
        if checked.on_film:
            check_film_receivers(view.scene, x, y, single_lobe=single_lobe)
            return checked
        hit = check_receiver(view.scene, x, y)
        if single_lobe:
            check_single_lobe(hit, dims)
        return checked


def describe_pixel(scene: Scene, x: int, y: int) -> dict[str, Any]:
    """Describe the surface that the ray through a pixel's centre meets.

    Returns
    -------
    dict
        ``shape`` (id), ``bsdf`` (type), ``light`` (name if the shape emits, else None),
        ``position`` and ``normal`` (three floats each, world space); all None where the ray leaves
        the scene.

    Raises
    ------
    ParameterError
        The pixel is outside the film.
    """
    with LOCK:
        hit = primary_hit(load_scene(scene), *check_pixel(scene, x, y))
        if not hit.bsdf:
            return dict.fromkeys(("shape", "bsdf", "light", "position", "normal"))
        return {
            "shape": hit.shape,
            "bsdf": hit.bsdf.class_name(),
            "light": hit.light,
            "position": _triple(hit.interaction.p),
            "normal": _triple(hit.interaction.n),
        }


def _triple(vector: Any) -> tuple[float, float, float]:
    return float(vector.x[0]), float(vector.y[0]), float(vector.z[0])
