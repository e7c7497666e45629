"""A pixel's direct illumination as an integrand on the unit cube (Mitsuba 3, ``llvm_ad_rgb``).

Method
------
The camera ray through the pixel's center fixes one surface point.
The direct illumination of this point is the integral ∫ f_r L_e V cos over directions.
Each strategy defines an integrand g(u) = f/p in primary space, the unit square.
The integrand is evaluated at the direction to which the strategy maps u.
``light`` samples a light, ``bsdf`` the BSDF, and ``environment`` a density of directions.
``mis-light`` and ``mis-bsdf`` weight the first two by a heuristic [VeachGuibas1995]_.
The heuristic is for equal numbers of samples.
With independent points, ``mis-light`` plus ``mis-bsdf`` is therefore multiple importance sampling.
`pixel_mis` supports all heuristics, and any counts and techniques.
All techniques sample directions, but each maps a separate unit cube to directions by its own warp.
Results therefore exist only in primary space, and densities are per steradian.
Light that reaches the camera directly is excluded.

Mitsuba computes in float32: values carry relative errors of about 1e-7.
Averages are computed in float64.
With all lights, Mitsuba selects a light at random, uniformly or by ``sampling_weight``.
The selection stretches the first coordinate: it cuts the square into strips and adds jumps.
A single light, or a separate coordinate that selects the light, avoids the additional jumps.
The columns of u have the following meanings:

===========  ==================================================================================
``dims=2``   direction
``dims=3``   direction; selection of a light, or of a lobe of the BSDF
``dims=4``   position in the pixel, from its upper left corner; direction
``dims=5``   position; direction; selection
===========  ==================================================================================

If positions are sampled, the integral is the mean over the pixel.
The integrand is 0 if a ray leaves the scene or hits a light.

`PixelView.draws` returns the densities of all techniques at one draw.
A technique is ``"light"``, ``"bsdf"`` or a density of directions (`Sky`).
Light sampling and skies are not combined, because both would sample the environment.
Where f is 0, only the technique that drew the direction gets a positive density.
The densities of all other techniques are set to 0 at this direction:
a ray that a surface blocks does not reveal the light behind the surface.
Every density p_t nevertheless integrates to 1.

`integral` is the mean over independently scrambled sets of Sobol' points.
The integrand of a pixel jumps along curves, the edges of lights and occluders.
If jumps are not parallel to any axis, Gauss-Legendre quadrature does not converge.
The scrambled points are unbiased for any integrand.
The spread of the means of the sets gives a reliable error [Owen1997]_.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, final

import numpy as np

from mcspectra.core.checks import Array, as_integer
from mcspectra.core.display import shown
from mcspectra.core.errors import Parameter, ParameterError
from mcspectra.core.fields import checked, choice, settle
from mcspectra.core.results import dataset
from mcspectra.core.streams import Stream
from mcspectra.densities import Density
from mcspectra.estimators.base import AbstractEstimator, check_counts, check_sets
from mcspectra.estimators.heuristics import Heuristic, Pilot, as_heuristic
from mcspectra.estimators.importance import Estimator, scale
from mcspectra.integrands import Integrand
from mcspectra.integrands.base import Estimate
from mcspectra.rendering.backend import LARGEST_SAMPLE, LOCK, load_mitsuba
from mcspectra.rendering.scene_checks import check_lights
from mcspectra.rendering.scenes import Scene, as_scene, find_emitter, load_scene, scene_name
from mcspectra.rendering.skies import Sky, environment_of, sky_technique
from mcspectra.rendering.techniques import (
    POWERS,
    check_film_receivers,
    check_finite,
    check_pixel,
    check_receiver,
    check_single_lobe,
    chosen_channel,
    film_hits,
    follow_bsdf,
    heuristic_weight,
    look_at_sky,
    primary_hit,
    sample_columns,
    sample_light,
)
from mcspectra.samplers import as_sampler

if TYPE_CHECKING:
    import xarray as xr

__all__ = [
    "CHUNK",
    "ENVIRONMENT",
    "MOST_DIMS",
    "SOURCE",
    "STRATEGIES",
    "Draws",
    "MitsubaIntegrand",
    "Pixel",
    "PixelMIS",
    "PixelView",
    "Technique",
    "check_channel",
    "check_view",
    "describe_pixel",
    "incident_light",
    "mean_of_points",
    "pixel_mis",
    "pixel_strategies",
]

STRATEGIES = ("light", "bsdf", "mis-light", "mis-bsdf")
"""Strategies that are available for any scene."""

ENVIRONMENT = "environment"
"""Strategy that is available for scenes with an environment map."""


class MitsubaIntegrand(Integrand):
    """Integrand that Mitsuba evaluates, for one or all channels.

    The integral is estimated by a mean over points.
    """

    costly: ClassVar[bool] = True
    stock_samplers: ClassVar[tuple[str, ...]] = (
        "mitsuba(sampler='multijitter')",
        "mitsuba(sampler='orthogonal')",
        "mitsuba(sampler='ldsampler')",
    )
    channel: str | int

    @property
    def channels(self) -> int:  # type: ignore[override]
        """Number of channels: 3 with ``channel="rgb"``, otherwise 0."""
        return 3 if self.channel == "rgb" else 0

    @property
    def integral_source(self) -> str:
        """How the integral is computed; its standard error is `integral_accuracy`."""
        return SOURCE

    def _estimated_integral(self) -> Estimate:
        return mean_of_points(self)


@final
@dataclass(frozen=True, kw_only=True)
class Pixel(MitsubaIntegrand):
    """Direct illumination of one pixel of a scene, by light or BSDF sampling.

    Parameters
    ----------
    scene
        A scene's name, the path of a Mitsuba XML file or a Mitsuba dictionary (see `load_scene`).
    x, y
        Pixel, counted from the left and from the top.
        The ray goes through the pixel's center if ``dims`` is below 4.
    strategy
        ``"light"``, ``"bsdf"``, or their parts of multiple importance sampling.
        The parts ``"mis-light"`` and ``"mis-bsdf"`` are used together.
        With ``"environment"``, directions are sampled by the given density.
    light
        Index or name of the only light to use. Other lights then emit nothing but still occlude.
        By default all lights are used.
    heuristic
        ``"balance"`` or ``"power"`` (β = 2), for the two ``mis-`` strategies.
    channel
        ``"luminance"`` (Rec. 709), 0, 1 or 2 for red, green or blue, or ``"rgb"`` for all three.
    dims
        2, or 3 if a third coordinate chooses a light or a lobe of the BSDF.
        With 4 or 5 dims, two further coordinates come first: the position in the pixel.
    density
        For ``"environment"``: a density in 2 dims over the square of latitude and longitude.
        Specs are accepted, for example ``"environment(interpolation='bilinear', channel=0)"``.
        A spec without a ``path`` means the environment map of the scene.
        By default, the density interpolates `channel` of this map bilinearly.
        Nothing is sampled where the density is 0.
        Compensation sets dark parts of a density to 0, so it may be used with `pixel_mis` only.

    Raises
    ------
    ParameterError
        If the pixel is outside the film, or shows a light or nothing.
        If its BSDF or a used light is a delta function, or the BSDF needs one more dim.
        If the light does not exist, or other lights are used with ``"environment"``.
        If a parameter is not allowed.
    MissingDependency
        If Mitsuba or LLVM is missing.
    """

    scene: Any = checked(lambda _, given: as_scene(given), "veach")
    x: int
    y: int
    strategy: str = choice(*STRATEGIES, ENVIRONMENT)
    light: int | str | None = None
    heuristic: str = choice(*POWERS)
    channel: str | int = "luminance"
    dims: int = 2
    density: Density | str | None = None

    def _check(self) -> None:
        if self.density is not None and self.strategy != ENVIRONMENT:
            raise ParameterError(
                f"density is for strategy='environment', not for {shown(self.strategy)}; leave it "
                "out."
            )
        view = check_view(self._view, bsdf=self.strategy.endswith("bsdf"))
        # Convert NumPy's integers to Python's
        settle(self, x=view.x, y=view.y, channel=view.channel, dims=view.dims)
        self._technique()

    def _evaluate(self, x: Array) -> Array:
        heuristic = self.heuristic if self.strategy.startswith("mis") else None
        return self._view.values(self._technique(), x, heuristic)

    @property
    def _view(self) -> PixelView:
        return PixelView(self.scene, self.x, self.y, self.light, self.channel, self.dims)

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
    """Return all strategies of a pixel by name. Parameters and errors are as in `Pixel`."""
    same: dict[str, Any] = locals()
    return {strategy: Pixel(**same, strategy=strategy) for strategy in STRATEGIES}


def check_view(view: PixelView, *, bsdf: bool) -> PixelView:
    """Check a pixel and return it with Python integers; errors are as in `Pixel`.

    The flag `bsdf` is true if the BSDF will be sampled, which may require one more dim.
    """
    channel = check_channel(view.channel, several=True)
    dims = as_integer("dims of a pixel", view.dims, least=2, most=MOST_DIMS)
    single_lobe = bsdf and dims % 2 == 0
    with LOCK:
        x, y = check_pixel(view.scene, view.x, view.y)
        check_lights(view.scene, view.light)
        checked = PixelView(view.scene, x, y, view.light, channel, dims)
        if checked.on_film:
            check_film_receivers(view.scene, x, y, single_lobe=single_lobe)
            return checked
        hit = check_receiver(view.scene, x, y)
        if single_lobe:
            check_single_lobe(hit, dims)
        return checked


def describe_pixel(scene: Scene, x: int, y: int) -> dict[str, Any]:
    """Describe the surface that the ray through a pixel's center hits.

    Returns
    -------
    dict
        ``shape`` (id), ``bsdf`` (type) and ``light`` (name; None without emission).
        ``position`` and ``normal`` have three floats each, in world space.
        All values are None if the ray leaves the scene.

    Raises
    ------
    ParameterError
        If the pixel is outside the film.
    """
    with LOCK:
        hit = primary_hit(load_scene(scene), *check_pixel(scene, x, y))
        if not hit.bsdf:
            return dict.fromkeys(("shape", "bsdf", "light", "position", "normal"))
        return {
            "shape": hit.shape,
            "bsdf": hit.bsdf.class_name(),
            "light": hit.light,
            "position": tuple(hit.interaction.p.numpy().ravel().tolist()),
            "normal": tuple(hit.interaction.n.numpy().ravel().tolist()),
        }


CHUNK = 2**20
"""Number of samples per kernel, for about 100 MiB of Dr.Jit's memory; more are not faster."""

MOST_DIMS = 5
_WITH_FILM = 4
_BY_NAME = ("light", "bsdf")

Technique = str | Sky


@dataclass(frozen=True)
class Draws:
    """Values f/p of M samples of one technique, and the densities of all T techniques.

    Values are (M,) or (M, 3). Densities are (T, M), per steradian.
    """

    values: Array
    pdfs: Array


@final
@dataclass(frozen=True)
class PixelView:
    """A pixel of a scene, and the lights used. The attributes are the same as in `Pixel`."""

    scene: Scene
    x: int
    y: int
    light: int | str | None
    channel: str | int
    dims: int

    @property
    def channels(self) -> int:
        """Number of channels: 3 with ``channel="rgb"``, otherwise 0."""
        return 3 if self.channel == "rgb" else 0

    @property
    def on_film(self) -> bool:
        """Whether the first two samples are a position in the pixel."""
        return self.dims >= _WITH_FILM

    def values(self, technique: Technique, u: Array, heuristic: str | None = None) -> Array:
        """Return f/p at u (..., dims), times a heuristic's weight if given: (...) or (..., 3)."""
        found = self.draws(technique, u.reshape(-1, self.dims), (), heuristic).values
        return found.reshape((*u.shape[:-1], *found.shape[1:]))

    def draws(
        self,
        technique: Technique,
        u: Array,
        among: Sequence[Technique],
        heuristic: str | None = None,
    ) -> Draws:
        """Return f/p at u (M, dims), weighted by a heuristic if given, and all densities at u."""
        values = np.empty((len(u), 3) if self.channels else len(u))
        pdfs = np.zeros((len(among), len(u)))
        for start in range(0, len(u), CHUNK):
            part = slice(start, start + CHUNK)
            with LOCK:
                chunk = self._drawn(technique, u[part], among, heuristic)
                values[part], pdfs[:, part] = chunk.values, chunk.pdfs
        check_finite(values[None], self.scene, np.array([[self.x, self.y]]))
        return Draws(values, pdfs)

    def _drawn(
        self, technique: Technique, u: Array, among: Sequence[Technique], heuristic: str | None
    ) -> Draws:
        """Return the same as `draws`, computed in one kernel."""
        import drjit

        # Evaluate f/p, and the densities of light and BSDF at the sampled directions.
        # The densities of the environment are evaluated below at the same directions
        mitsuba, scene, count = load_mitsuba(), load_scene(self.scene), len(u)
        hit = primary_hit(scene, self.x, self.y)
        if self.on_film:
            hit = film_hits(scene, self.x, self.y, np.minimum(u[:, :2], LARGEST_SAMPLE))
            u = u[:, 2:]
        pdfs: dict[Technique, Array] = {}
        directions = np.empty((0, 3))
        if isinstance(technique, Sky):
            emitter = scene.environment()
            directions, own = technique.sample(u[:, :2])
            towards = mitsuba.Vector3f(*(np.ascontiguousarray(c, np.float32) for c in directions.T))
            value, bsdf = look_at_sky(hit, emitter, towards, hit.active)
            drjit.eval(value, bsdf)  # evaluate the value and the BSDF density in one kernel
            f = np.asarray(_numbers(value, self.channel, count), np.float64)
            scaled = own if f.ndim == 1 else own[:, None]
            values = np.divide(f, scaled, out=np.zeros_like(f), where=scaled > 0)
            pdfs |= {technique: own, "bsdf": _spread(bsdf.numpy(), count)}
        else:
            columns = sample_columns(u)
            emitter = None if self.light is None else find_emitter(self.scene, self.light)
            extra = columns[2] if len(columns) > 2 else None
            given = hit, emitter, mitsuba.Point2f(*columns[:2]), extra, hit.active
            if technique == "light":
                value, light, bsdf = sample_light(*given)
                own, other = light, bsdf
            else:
                value, bsdf, light, towards = follow_bsdf(*given)
                own, other = bsdf, light
            if heuristic is not None:
                value *= heuristic_weight(own, other, POWERS[heuristic])
            if among:
                drjit.eval(value, own, other, *([towards] if technique == "bsdf" else []))
                pdfs |= {
                    n: _spread(p.numpy(), count) for n, p in (("light", light), ("bsdf", bsdf))
                }
            if technique == "bsdf" and any(isinstance(t, Sky) for t in among):
                directions = np.asarray(_spread(towards.numpy().T, (count, 3)), np.float64)
            values = _numbers(value, self.channel, count)

        # Where f is 0, treat the direction as impossible for the other techniques
        lit = values != 0.0 if values.ndim == 1 else (values != 0.0).any(axis=1)
        rows = np.zeros((len(among), count))
        for row, other in zip(rows, among, strict=True):
            if isinstance(other, Sky) and other is not technique:
                pdfs[other] = other.pdf(directions)
            row[:] = pdfs[other] if other == technique else np.where(lit, pdfs[other], 0.0)
        return Draws(np.asarray(values, np.float64), rows)


def check_channel(channel: object, *, several: bool = False) -> str | int:
    """Check a channel and return it: "luminance", 0, 1 or 2; with `several` also "rgb"."""
    names = ("luminance", "rgb") if several else ("luminance",)
    if isinstance(channel, str) and channel in names:
        return str(channel)
    try:
        return as_integer("channel", channel, least=0, most=2)
    except ParameterError:
        allowed = ", ".join(map(repr, names))
        raise ParameterError(
            Parameter("channel"), f" is {shown(channel)}; give {allowed}, 0, 1 or 2."
        ) from None


def _numbers(color: Any, channel: str | int, count: int) -> Array:
    """Copy a color to an array (count,) or (count, 3)."""
    if channel == "rgb":
        return _spread(color.numpy().T, (count, 3))
    return _spread(chosen_channel(color, channel).numpy(), count)


def _spread(found: Any, shape: int | tuple[int, ...]) -> Array:
    """Broadcast to the given shape, because Dr.Jit keeps constants as arrays of size 1."""
    return np.broadcast_to(np.asarray(found), shape)


def incident_light(
    scene: Scene,
    x: int,
    y: int,
    *,
    light: int | str | None = None,
    channel: str | int = "luminance",
    resolution: int = 128,
) -> xr.Dataset:
    """Compute the light that reaches the surface point of a pixel from all directions.

    Parameters
    ----------
    scene, x, y, light
        Same as in the class `Pixel`.
    channel
        ``"luminance"``, 0, 1 or 2.
    resolution
        Number of rows of elevation, 4 to 1024. There are four times as many columns of azimuth.

    Returns
    -------
    xarray.Dataset
        The variables have the dims (elevation, azimuth), with values at cell centers.
        The elevation is in degrees above the surface, the azimuth in degrees around its normal.
        "Above" means on the side of the camera.
        ``incident_radiance`` is L_e of the used lights, or 0 where a surface blocks them.
        ``reflected_radiance`` is f_r L_e cos per steradian.
        Every strategy of `Pixel` has the same integral as ``reflected_radiance`` over directions.

    Raises
    ------
    ParameterError
        If the resolution is out of range, the channel is ``"rgb"``, or the pixel is invalid.
    """
    request = as_scene(scene)
    rows = as_integer("resolution", resolution, least=4, most=1024)
    chosen = check_channel(channel)
    elevation = (np.arange(rows) + 0.5) * (90.0 / rows)
    azimuth = (np.arange(4 * rows) + 0.5) * (90.0 / rows)
    with LOCK:
        x, y = check_pixel(request, x, y)
        check_lights(request, light)
        hit = check_receiver(request, x, y)
        emitter = None if light is None else find_emitter(request, light)
        import drjit

        # Unit vectors (3, rows · columns) in the frame of the surface, on the camera's side
        mitsuba, at = load_mitsuba(), hit.interaction
        up, around = np.meshgrid(np.radians(elevation), np.radians(azimuth), indexing="ij")
        level, side = np.cos(up), np.where(at.wi.z.numpy() < 0.0, -1.0, 1.0).item()
        vectors = (level * np.cos(around), level * np.sin(around), side * np.sin(up))
        towards = mitsuba.Vector3f(*(v.astype(np.float32).ravel() for v in vectors))
        # Compute L and f_r L cos in each direction. Textured lights need UV coordinates
        ray = at.spawn_ray(at.to_world(towards))
        met = hit.scene.ray_intersect(ray, mitsuba.RayFlags.UV, False)
        found = met.emitter(hit.scene)
        counts = True if emitter is None else found == mitsuba.EmitterPtr(emitter)
        radiance = drjit.select(counts, found.eval(met), 0.0)
        reflected = radiance * hit.bsdf.eval(mitsuba.BSDFContext(), at, towards)
        seen = [_numbers(color, chosen, level.size) for color in (radiance, reflected)]
    names = ("incident_radiance", "reflected_radiance")
    return dataset(
        {
            name: (("elevation", "azimuth"), values.astype(np.float64).reshape(level.shape))
            for name, values in zip(names, seen, strict=True)
        },
        {"elevation": elevation, "azimuth": azimuth},
        scene=scene_name(request),
        x=x,
        y=y,
        light=light,
        channel=chosen,
    )


SOURCE = "mean of 16 Owen-scrambled sets of 2^17 Sobol' points"
"""How the integral of a pixel is computed. The attribute `integral_source` returns this text."""

_POINTS, _SETS = 2**17, 16
_TOGETHER = 2**17  # points of one call, because recording the operations takes time as well
_SEED = 20_170_623
# Relative rounding error of values. The spread of values over sets does not contain this error
_SINGLE = float(np.finfo(np.float32).eps)


def mean_of_points(integrand: Integrand) -> Estimate:
    """Estimate ∫ g in C channels (C,), with C = 1 for a scalar, and the largest standard error."""
    sampler, stream = as_sampler("sobol | owen", integrand.dims), Stream.from_rng(_SEED)
    step = min(max(_TOGETHER // _POINTS, 1), _SETS)
    drawn = (sampler.draw_stream(_POINTS, stream, k, step) for k in range(0, _SETS, step))
    means = np.stack(
        [each.reshape(_POINTS, -1).mean(axis=0) for u in drawn for each in integrand(u)]
    )
    value = means.mean(axis=0)
    spread = means.std(axis=0, ddof=1) / _SETS**0.5
    error = np.hypot(spread, _SINGLE * np.abs(value))
    return Estimate(value, float(error.max()), SOURCE)


@final
class PixelMIS(AbstractEstimator):
    """Multiple importance sampling of a pixel's direct illumination, created by `pixel_mis`.

    Attributes
    ----------
    techniques
        The techniques given to `pixel_mis`: names such as ``"light"`` or ``"bsdf"``, and densities.
    heuristic
        Spec of the heuristic.
    shares
        Relative sample counts of the techniques. Heuristics that use f adapt these counts.
    control
        Coefficients α_t of the control variate of ``optimal`` weights, (T,) or (T, 3), or None.
    """

    def __init__(
        self,
        view: PixelView,
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
        """Number of dims, the same for every technique."""
        return self.view.dims

    def _primary(self, technique: int) -> Integrand:
        return _Weighted(self, technique)

    def primary_values(self, technique: int, u: Array) -> Array:
        """Weighted values w_t f/p_t; for optimal weights α_t + (f − Σ α_s p_s) w_t/p_t."""
        flat = u.reshape(-1, self.dims)
        values = self._weigh(technique, self.draws(technique, flat))
        return values.reshape((*u.shape[:-1], *values.shape[1:]))

    def draws(self, technique: int, u: Array) -> Draws:
        """Values f/p_t of one technique, and the densities of all techniques, at u (M, dims)."""
        return self.view.draws(self._bound[technique], u, self._bound)

    def with_heuristic(self, heuristic: str) -> PixelMIS:
        """Return the estimator with another heuristic, and the same techniques, counts and sets."""
        return PixelMIS(
            self.view, self.techniques, heuristic=heuristic, counts=self.counts, sets=self.sets
        )

    def alone(self, technique: int) -> Estimator:
        """Return the estimator that uses one technique alone."""
        given = self.techniques[technique]
        if isinstance(given, str) and given in (*_BY_NAME, ENVIRONMENT):
            return Estimator(Pixel(strategy=given, **vars(self.view)))
        return Estimator(Pixel(strategy=ENVIRONMENT, density=given, **vars(self.view)))

    def technique_name(self, technique: int) -> str:
        """Return ``light``, ``bsdf`` or the spec of a density."""
        given = self.techniques[technique]
        return given.spec if isinstance(given, Density) else given

    def _weigh(self, technique: int, draws: Draws) -> Array:
        """Compute the values g_t from the draws of a technique: (M,) or (M, 3)."""
        own = draws.pdfs[technique]
        q = np.asarray(self.shares)[:, None] * draws.pdfs
        over = self.shares[technique] * self._weights.ratio(q, technique)  # w_t/p_t
        if self.control is None:
            return scale(draws.values, own * over)
        left = scale(draws.values, own) - draws.pdfs.T @ self.control
        # A lost sample, such as one below the surface, does not come from p_t and adds nothing
        sampled = own > 0.0 if left.ndim == 1 else (own > 0.0)[:, None]
        return np.where(sampled, self.control[technique] + scale(left, over), 0.0)


@final
@dataclass(frozen=True, eq=False)
class _Weighted(MitsubaIntegrand):
    """The integrand g_t of one technique in multiple importance sampling of a pixel."""

    name: ClassVar[str] = "pixel-technique"
    estimator: PixelMIS
    technique: int

    @property
    def dims(self) -> int:  # type: ignore[override]
        """Number of dims of the technique."""
        return self.estimator.dims

    @property
    def channel(self) -> str | int:  # type: ignore[override]
        """Channel of the pixel."""
        return self.estimator.view.channel

    @property
    def spec(self) -> str:
        """Name of the integrand in messages."""
        return f"{self.estimator.technique_name(self.technique)} of {self.estimator.spec}"

    def _evaluate(self, x: Array) -> Array:
        return self.estimator.primary_values(self.technique, x)


@final
@dataclass(frozen=True, eq=False)
class _PixelPilot(Pilot):
    """Pilot samples, one per row: the densities of T techniques, and then the channels of f."""

    estimator: PixelMIS
    shares: Array

    @property
    def channels(self) -> int:  # type: ignore[override]
        """Number of channels of the pixel."""
        return self.estimator.channels

    def points(self, technique: int, count: int, seed: int) -> Array:
        """Return densities and f of random samples of a technique: (count, T + C)."""
        stream, dims = Stream.from_rng(seed).child(technique), self.estimator.dims
        drawn = self.estimator.draws(
            technique, stream.uniforms(0, 1, count * dims).reshape(-1, dims)
        )
        f = scale(drawn.values, drawn.pdfs[technique]).reshape(count, -1)
        return np.concatenate([drawn.pdfs.T, f], axis=1)

    def pdfs(self, x: Array) -> Array:
        """Densities p_t of all techniques: (T, k)."""
        return x[:, : len(self.shares)].T

    def values(self, x: Array) -> Array:
        """Values of f in all channels: (k, C)."""
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
    """Return the multiple importance sampling estimator of one pixel.

    Parameters
    ----------
    scene, x, y, light, channel, dims
        Same as in the class `Pixel`.
    heuristic
        Name or spec from `mcspectra.estimators.HEURISTICS`, or a heuristic object.
        ``optimal`` and ``variance-aware`` use a pilot, by default 4096 random samples with seed 0.
        The pilot of these heuristics cannot be a quadrature, as techniques share no domain.
    techniques
        ``"light"``, ``"bsdf"``, and densities for the environment as in `Pixel`,
        or ``"environment"`` for the scene's own map.
        Several densities are allowed, but not together with ``"light"``.
    counts
        Samples of each technique as multiples of n; by default equal.
    sets
        Dependence between the points of the techniques, as in `mcspectra.estimators.base`.

    Raises
    ------
    ParameterError
        Same as in `Pixel`; also if techniques, counts or heuristic are invalid.

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
            f"techniques is {shown(techniques)}; give a list of 'light', 'bsdf', 'environment' and "
            "densities."
        )
    repeated = sum(t == "light" for t in given) > 1 or sum(t == "bsdf" for t in given) > 1
    if repeated or ("light" in given and any(t not in _BY_NAME for t in given)):
        raise ParameterError(
            f"techniques is {shown(techniques)}; give 'light' and 'bsdf' at most once, and "
            "densities without 'light', which also samples the environment."
        )
    asked = PixelView(as_scene(scene), x, y, light, channel, dims)
    view = check_view(asked, bsdf="bsdf" in given)
    return PixelMIS(view, given, heuristic=heuristic, counts=counts, sets=sets)


def _bound(view: PixelView, technique: Density | str) -> Technique:
    """Return a named technique unchanged, and a density as a technique of the environment."""
    if isinstance(technique, str) and technique in _BY_NAME:
        return technique
    environment_of(view.scene, view.light)
    own = None if technique == ENVIRONMENT else technique
    return sky_technique(view.scene, own, view.channel)
