"""Whole light paths as integrands on the unit cube: any sampling integrator of Mitsuba.

Method
------
An integrator requests random numbers from a sampler.
Our sampler answers these requests in order with the D coordinates of a point u.
The radiance is therefore a function of u in [0,1)^D.
The integral of the radiance over the cube is the mean over a pixel with a box filter.
The first coordinates choose the position in the pixel, the point on the lens and the time.
Mitsuba's own rendering loop has the same order.
The sampler advances for each request, even if a path does not need the number.
A coordinate therefore has the same meaning for all paths.
Numbers for bounces that a path does not reach have no effect on that path.

A dry run finds D and the bounce of each number. Its loop is not recorded but evaluated:
Dr.Jit evaluates the number of requested random numbers after each iteration.
If the requests of a bounce match an integrator of Mitsuba, the decision of each number is known.
For any other integrator, decisions are named ``request 1``, ``request 2`` and so on.
Mitsuba selects a light by stretching the first coordinate of its point.
The choice of the light and the choice of a point on it are therefore one decision.

Rare paths need more than D random numbers. If D is set to a smaller number, any path may need more.
Random numbers after the first D are hashed from the last two coordinates.
The integrand remains a function of u, but good points do not spread hashed numbers evenly.

Integrators return the radiance of all lights together.
The choice of paths does not depend on the emission.
The radiance of each path is therefore linear in the emission.
With all lights but one dimmed to 2^-30, the radiance is the part of that light.
Lights are only dimmed, because the points on a light are chosen by the texture of its emission.
"""

from __future__ import annotations

import contextlib
import functools
import math
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, final

import numpy as np

from mcspectra.core.checks import MAX_DIMS, Array, as_integer, as_real
from mcspectra.core.display import counted, shown
from mcspectra.core.errors import Parameter, ParameterError
from mcspectra.core.fields import checked, settle
from mcspectra.rendering.backend import LARGEST_SAMPLE, LOCK, load_mitsuba
from mcspectra.rendering.pixel import MitsubaIntegrand, check_channel
from mcspectra.rendering.scenes import (
    Scene,
    as_scene,
    emitter_name,
    emitter_names,
    film_size,
    integrator_plugin,
    integrator_text,
    load_scene,
    mitsuba_reason,
    scene_name,
    sensor_of,
)
from mcspectra.rendering.techniques import (
    check_finite,
    check_pixel,
    chosen_channel,
    corners_of,
    pixel_sums,
)
from mcspectra.samplers import Sampler, as_sampler

__all__ = [
    "SCENE_INTEGRATOR",
    "Dimension",
    "PathPixel",
    "Tracer",
    "dimensions_of",
    "find_integrator",
    "in_dims",
    "light_selection",
    "parts_by_light",
    "path_pixel",
    "window_dimensions",
]

SCENE_INTEGRATOR = "scene"
"""Name of the integrator that the scene itself contains."""

# A dry run follows 2^14 paths through 16 × 16 pixels of a window
_DRY_LANES, _DRY_PIXELS = 2**14, 16
_PAIR = ("x", "y")
_MOST_DIMS = 64  # default limit of dims, because analyses by axes support no more
# Limits of one kernel: values in its table of numbers (128 MiB), and number of lanes
_TABLE_NUMBERS, _LANES = 2**25, 2**20
_DIMMED = 2.0**-30  # factor that dims all lights except one; exact in float32
_EMITTED = r"(\w+_)?scale|(radiance|intensity|irradiance)\.(.+\.)?(value|data)"
_PATH = ((2, "light"), (1, "lobe"), (2, "direction"), (1, "roulette"))
_ORDERS = {
    # Random numbers that a bounce requests, by class of integrator: (how many, for which decision)
    "PathIntegrator": (_PATH,),
    "PRBIntegrator": (_PATH,),
    # Lobe and direction occur in either order, because compilers order arguments differently
    "DirectIntegrator": (_PATH[:3], (_PATH[0], _PATH[2], _PATH[1])),
}


@final
@dataclass(frozen=True)
class Dimension:
    """Describes one coordinate of u: its bounce, and the decision that uses it.

    Attributes
    ----------
    bounce
        0 for the camera, otherwise the iteration of the integrator's loop, counted from 1.
    decision
        ``film``, ``lens``, ``time``, ``light`` (which light, and which point on it),
        ``lobe``, ``direction`` or ``roulette``.
        If the integrator's order is unknown, the name is ``request K``.
    part
        ``x`` or ``y`` if two numbers are requested together. Empty for a single number.
    """

    bounce: int
    decision: str
    part: str = ""

    def __str__(self) -> str:
        head = f"bounce {self.bounce} " if self.bounce else ""
        return f"{head}{self.decision} {self.part}".rstrip()


@final
@dataclass(frozen=True, kw_only=True)
class PathPixel(MitsubaIntegrand):
    """Radiance of one pixel by any sampling integrator, as a function of all random numbers.

    Parameters
    ----------
    scene
        A scene's name, the path of a Mitsuba XML file or a Mitsuba dictionary (see `load_scene`).
    x, y
        Pixel, counted from the left and from the top. The integral is the mean over the pixel.
    integrator
        ``"scene"`` is the scene's own integrator.
        Any plugin may be named with its properties: ``"path(max_depth=5, rr_depth=100)"``.
        Your own plugins that are registered with Mitsuba also work.
    channel
        ``"luminance"`` (Rec. 709), 0, 1 or 2 for red, green or blue, or ``"rgb"`` for all three.
    dims
        Number of coordinates D; by default the number that 16,384 random paths use, at most 64.
        Numbers that a path takes beyond D are pseudo-random.
    selection
        Relative probabilities of the lights: positive numbers in the order of `emitter_names`.
        These probabilities replace the sampling weights of the lights in the scene.

    Attributes
    ----------
    dimensions
        What each coordinate is used for, a tuple of `Dimension`.

    Raises
    ------
    ParameterError
        If the pixel is outside the film or the scene has no integrator.
        If the integrator is unknown, rejects its properties, or cannot follow a camera ray.
    MissingDependency
        If Mitsuba or LLVM is missing.
    """

    scene: Any = checked(lambda _, given: as_scene(given), "veach")
    x: int
    y: int
    integrator: str = SCENE_INTEGRATOR
    channel: str | int = "luminance"
    dims: Any = None
    selection: Any = None

    def _check(self) -> None:
        channel = check_channel(self.channel, several=True)
        with LOCK:
            x, y = check_pixel(self.scene, self.x, self.y)
            if self.selection is not None:
                lights = emitter_names(self.scene)
                given = np.atleast_1d(self.selection).tolist()
                if len(given) != len(lights):
                    raise ParameterError(
                        f"selection has {counted(len(given), 'value')}; give a positive number for "
                        f"each of the lights {', '.join(lights)}."
                    )
                weights = [as_real("selection", w, above=0.0) for w in given]
                settle(self, selection=tuple(w / math.fsum(weights) for w in weights))
            settle(self, x=x, y=y, channel=channel)
            found = self.dimensions
        asked = len(found) if self.dims is None else self.dims
        settle(self, dims=as_integer("dims of a path", asked, least=2, most=MAX_DIMS))

    @property
    def dimensions(self) -> tuple[Dimension, ...]:
        """Purpose of each coordinate, as found by a dry run that traces some paths.

        The purpose of a coordinate is unknown if all traced paths have fewer coordinates.
        """
        return self._tracer.dimensions(((self.x, self.y),), self.dims)

    @property
    def numbers_per_path(self) -> float:
        """Mean number of random numbers that a path requests, excluding the camera's.

        Each iteration of the integrator's loop requests the same count of numbers.
        """
        return self._tracer.dry_run(((self.x, self.y),))[1]

    @property
    def _tracer(self) -> Tracer:
        size = film_size(self.scene)
        return Tracer(self.scene, self.integrator, self.channel, size, self.selection)

    def _evaluate(self, x: Array) -> Array:
        return self._values(self._tracer, x)

    def _values(self, tracer: Tracer, x: Array) -> Array:
        samples = x.reshape(-1, 1, self.dims)
        found = tracer.means(samples, np.array([[self.x, self.y]]))[:, 0]
        return found.reshape((*x.shape[:-1], 3) if self.channels else x.shape[:-1])


def path_pixel(
    scene: Scene,
    x: int,
    y: int,
    *,
    integrator: str | None = None,
    channel: str | int = "luminance",
    dims: int | None = None,
    selection: Sequence[float] | None = None,
) -> PathPixel:
    """Return the radiance of a pixel as an integrand. Parameters and errors are as in `PathPixel`.

    If `integrator` is None, the scene's own integrator is used.
    """
    given: Any = {"channel": channel, "dims": dims, "selection": selection}
    return PathPixel(
        scene=scene,
        x=x,
        y=y,
        integrator=SCENE_INTEGRATOR if integrator is None else integrator,
        **given,
    )


def light_selection(scene: Scene) -> Array:
    """Return the probabilities (L,) of Mitsuba's lights in the order of `emitter_names`."""
    with LOCK:
        weights = np.array([float(e.sampling_weight()) for e in load_scene(scene).emitters()])
    return np.asarray(weights / weights.sum())


def parts_by_light(f: PathPixel, u: Array) -> Array:
    """Split the values of f at points u (..., D) by light. The parts (L, ...) sum to f.

    Mitsuba cannot change the emission of some lights, such as a black body.
    A scene with such a light raises a ParameterError.
    """
    with LOCK:
        lights = len(load_scene(f.scene).emitters())
    tracers = (replace(f._tracer, light=k) for k in range(lights))
    return np.stack([f._values(tracer, u) for tracer in tracers])


def window_dimensions(
    tracer: Tracer, window: tuple[int, int, int, int], dims: int | None
) -> tuple[Dimension, ...]:
    """Return what each coordinate is used for by paths through a window (x0, y0, width, height).

    By default, the number of coordinates is what paths through 256 pixels use, at most 64.
    """
    x0, y0, width, height = window
    xs = np.unique(x0 + np.linspace(0, width - 1, _DRY_PIXELS).astype(int)).tolist()
    ys = np.unique(y0 + np.linspace(0, height - 1, _DRY_PIXELS).astype(int)).tolist()
    return tracer.dimensions(tuple((x, y) for y in ys for x in xs), dims)


def in_dims(sampler: Sampler, dims: int) -> Sampler:
    """Return the sampler in other dims; new coordinates are scrambled in their own bases."""
    made = as_sampler(sampler.plain.spec, dims)
    for step in sampler.randomizations:
        own: Any = step
        made = made.then(
            replace(own, base=None) if isinstance(getattr(step, "base", None), tuple) else step
        )
    return made


@final
@dataclass(frozen=True)
class Tracer:
    """Paths of one integrator through the pixels of a grid that is laid over the film."""

    scene: Scene
    integrator: str
    channel: str | int
    size: tuple[int, int]
    # Probability of each light; by default the scene's own probabilities
    selection: tuple[float, ...] | None = None
    # Index of the only light that is not dimmed; by default no light is dimmed
    light: int | None = None

    def dimensions(
        self, pixels: tuple[tuple[int, int], ...], dims: int | None = None
    ) -> tuple[Dimension, ...]:
        """Return how paths through these pixels use each of the first `dims` coordinates of u.

        By default, `dims` is the number that paths use, at most 64. Further ones are "unknown".
        """
        found = self.dry_run(pixels)[0]
        count = min(len(found), _MOST_DIMS) if dims is None else dims
        beyond = Dimension(1 + max(d.bounce for d in found), "unknown")
        return (*found[:count], *[beyond] * (count - len(found)))

    def dry_run(self, pixels: tuple[tuple[int, int], ...]) -> tuple[tuple[Dimension, ...], float]:
        # A dry run only records how the paths of a scene use random numbers.
        # The probabilities and the brightness of lights do not change how paths use random numbers
        lit = replace(self, selection=None, light=None)
        with LOCK:
            return dimensions_of(load_scene(self.scene))(lit, pixels)

    def means(self, u: Array, pixels: Array) -> Array:
        """Return means over samples at pixels (P, 2): float64 (R, P) or (R, P, 3).

        Samples u are (R, n, D), equal for all pixels, or (R, P, n, D).
        Values that are not finite raise a ParameterError.
        """
        numbers = max(u[0].size, 1) if len(u) else 1
        step = max(1, min(_TABLE_NUMBERS // numbers, _LANES // len(pixels)))
        parts = []
        for start in range(0, len(u), step):
            with LOCK, self._lights():
                parts.append(self._sums(u[start : start + step], pixels))
        shape = (0, len(pixels), 3 if self.channel == "rgb" else 1)
        found = np.concatenate([np.zeros(shape), *parts]) / u.shape[-2]
        check_finite(found.swapaxes(0, 1), self.scene, pixels)
        return np.asarray(found if self.channel == "rgb" else found[..., 0])

    @contextlib.contextmanager
    def _lights(self) -> Iterator[None]:
        """Change the probabilities and dimming of the lights inside the block; needs the lock."""
        if self.selection is None and self.light is None:
            yield
            return
        loaded, changed = load_scene(self.scene), []
        try:
            for k, emitter in enumerate(loaded.emitters()):
                parameters = load_mitsuba().traverse(emitter)
                values = {} if self.selection is None else {"sampling_weight": self.selection[k]}
                if self.light not in (None, k):
                    # Find the parameter that scales the light's radiance
                    keys = list(parameters.keys())
                    emitted = [p for p in keys if re.fullmatch(_EMITTED, p)]
                    if not emitted:
                        raise ParameterError(
                            f"The light {emitter_name(emitter)} ({emitter.class_name()}) has no "
                            f"radiance that can be dimmed, only {', '.join(keys)}; its part cannot "
                            "be computed."
                        )
                    values |= {p: parameters[p] * _DIMMED for p in emitted}
                changed.append(
                    (parameters, {p: type(parameters[p])(parameters[p]) for p in values})
                )
                parameters.update(values)
            loaded.parameters_changed([])
            yield
        finally:
            for parameters, values in changed:
                parameters.update(values)
            loaded.parameters_changed([])

    def _sums(self, u: Array, pixels: Array) -> Array:
        """Return sums over samples, (R, P, channels). Each lane is one realization of one pixel."""
        import drjit

        mitsuba, corners = load_mitsuba(), corners_of(pixels)
        table = np.minimum(u.astype(np.float32).ravel(), np.float32(LARGEST_SAMPLE))
        numbers, dims = mitsuba.Float(table), drjit.opaque(mitsuba.UInt32, u.shape[-1])

        def at(pixel: Any) -> Callable[[Any], Sequence[Any]]:
            x, y = (drjit.gather(mitsuba.Float, c, pixel) for c in corners)

            def values(row: Any) -> Sequence[Any]:
                sampler = _sampler_class()(_Numbers(numbers, dims, row * dims))
                color = self.trace(sampler, x, y)
                return color if self.channel == "rgb" else [chosen_channel(color, self.channel)]

            return values

        return np.moveaxis(pixel_sums(u, len(pixels), 3 if self.channel == "rgb" else 1, at), 0, -1)

    def trace(self, sampler: Any, x: Any, y: Any, film: Any = None) -> Any:
        """Return the radiance along a path through pixel (x, y), as in Mitsuba's own loop.

        The position in the pixel is `film`; by default it is the next pair of the sampler.
        """
        mitsuba, loaded = load_mitsuba(), load_scene(self.scene)
        sensor, integrator = sensor_of(self.scene), find_integrator(self.scene, self.integrator)
        film = sampler.next_2d() if film is None else film
        lens = sampler.next_2d() if sensor.needs_aperture_sample() else mitsuba.Point2f(0.5)
        time = sensor.shutter_open()
        if sensor.shutter_open_time() > 0.0:
            time = time + sampler.next_1d() * sensor.shutter_open_time()
        position = mitsuba.Point2f((film.x + x) / self.size[0], (film.y + y) / self.size[1])
        ray, weight = sensor.sample_ray_differential(time, 0.5, position, lens)
        if isinstance(integrator, mitsuba.ad.integrators.common.ADIntegrator):
            import drjit

            # Mitsuba's differentiable integrators take a mode as an argument
            found = integrator.sample(
                mode=drjit.ADMode.Primal,
                scene=loaded,
                sampler=sampler,
                ray=ray,
                depth=mitsuba.UInt32(0),
                δL=None,
                δaovs=None,
                state_in=None,
                active=mitsuba.Bool(True),
            )
        else:
            found = integrator.sample(loaded, sampler, ray, sensor.get_medium(), True)
        return weight * found[0]


def find_integrator(scene: Scene, spec: object) -> Any:
    """Return the integrator of a spec, or the scene's own; it must trace single rays."""
    spec = integrator_text(spec)
    if spec == SCENE_INTEGRATOR:
        found, called = load_scene(scene).integrator(), f"The integrator of {scene_name(scene)}"
        if found is None:
            raise ParameterError(
                f"The scene {scene_name(scene)} names no integrator; give one, e.g. ",
                Parameter("integrator", "path"),
                ".",
            )
    else:
        found, called = _made(spec), f"The integrator {spec!r}"
    if not isinstance(found, load_mitsuba().SamplingIntegrator):
        raise ParameterError(
            f"{called} ({_kind(found)}) cannot follow a ray from the camera; give another one, "
            "such as 'path', 'volpath' or 'direct'."
        )
    return found


@functools.lru_cache(maxsize=8)
def _made(spec: str) -> Any:
    """Create an integrator from its plugin name and properties."""
    plugin = integrator_plugin(spec)
    try:
        return load_mitsuba().load_dict(plugin)
    except (RuntimeError, TypeError, KeyError) as error:
        raise ParameterError(
            f"The integrator {shown(spec)} cannot be made: {mitsuba_reason(error)}; give 'scene', "
            "or a plugin of Mitsuba's with its properties, such as 'path(max_depth=5)'."
        ) from None


def _kind(found: Any) -> str:
    """Class name of an integrator, in Mitsuba or in Python."""
    name = str(found.class_name())
    return type(found).__name__ if name == "SamplingIntegrator" else name


class _Numbers:
    """Coordinates of points in Dr.Jit's memory; not a dataclass, so loops do not copy them."""

    def __init__(self, table: Any, dims: Any, first: Any) -> None:
        import drjit

        mitsuba = load_mitsuba()
        self._table, self._dims, self._first = table, dims, first
        seeds = [first, mitsuba.UInt32(0)]
        if table is not None:
            last = [drjit.gather(mitsuba.Float, table, first + dims - k) for k in (1, 2)]
            seeds = [drjit.reinterpret_array(mitsuba.UInt32, v) for v in last]
        self._seeds = mitsuba.sample_tea_32(*seeds)

    def __call__(self, k: Any, active: Any) -> Any:
        """Return coordinate k, or a hashed number if k is beyond the last coordinate."""
        import drjit

        mitsuba = load_mitsuba()
        beyond = mitsuba.sample_tea_float32(self._seeds[0], self._seeds[1] + k)
        if self._table is None:
            return beyond
        inside = k < self._dims
        own = drjit.gather(mitsuba.Float, self._table, self._first + k, inside & active)
        return drjit.select(inside, own, beyond)


@functools.cache
def _sampler_class() -> Any:
    import drjit

    mitsuba = load_mitsuba()

    class Coordinates(mitsuba.Sampler):  # type: ignore[misc,name-defined]
        """Returns coordinates in order, and records how many are requested in each iteration."""

        def __init__(self, numbers: _Numbers) -> None:
            super().__init__(mitsuba.Properties())
            self.numbers, self.count = numbers, mitsuba.UInt32(0)
            self.requests: list[tuple[int, bool]] = []

        def _next(self, number: int, active: Any) -> list[Any]:
            self.requests.append((number, self.count.state == drjit.VarState.Evaluated))
            found = [self.numbers(self.count + k, active) for k in range(number)]
            self.count = self.count + number
            return found

        def next_1d(self, active: Any = True) -> Any:
            return self._next(1, active)[0]

        def next_2d(self, active: Any = True) -> Any:
            return mitsuba.Point2f(*self._next(2, active))

        def fork(self) -> Any:
            return self

        clone = fork

        def schedule_state(self) -> None:
            drjit.schedule(self.count)

    return Coordinates


@functools.lru_cache(maxsize=4)
def dimensions_of(scene: Any) -> Callable[..., tuple[tuple[Dimension, ...], float]]:
    """Return a cached function for the dry runs of a scene. At most four scenes are kept."""
    del scene
    return functools.lru_cache(maxsize=256)(_dry_run)


def _dry_run(
    tracer: Tracer, pixels: tuple[tuple[int, int], ...]
) -> tuple[tuple[Dimension, ...], float]:
    """Follow random paths, and record the random numbers that each iteration requests.

    Dr.Jit evaluates the loop one iteration at a time, instead of recording the whole loop.
    """
    import drjit

    mitsuba = load_mitsuba()
    lane = drjit.arange(mitsuba.UInt32, _DRY_LANES)
    sampler = _sampler_class()(_Numbers(None, None, lane))
    place = lane % len(pixels)
    x, y = (mitsuba.Float(np.array(c, np.float32)) for c in zip(*pixels, strict=True))
    x, y = drjit.gather(mitsuba.Float, x, place), drjit.gather(mitsuba.Float, y, place)
    with drjit.scoped_set_flag(drjit.JitFlag.SymbolicLoops, False):
        try:
            color = tracer.trace(sampler, x, y)
        except (RuntimeError, TypeError) as error:
            raise ParameterError(
                f"Mitsuba cannot trace paths of {shown(tracer.integrator)} through "
                f"{scene_name(tracer.scene)}: {mitsuba_reason(error)}; choose another integrator."
            ) from None
        drjit.eval(color, sampler.count)
    counts = sampler.count.numpy()
    asked, mean = int(np.max(counts)), float(np.mean(counts))

    # Separate the random numbers of the camera from those of each iteration of the loop
    sensor = sensor_of(tracer.scene)
    camera = ["film", *["lens"] * sensor.needs_aperture_sample()]
    camera += ["time"] * (sensor.shutter_open_time() > 0.0)
    decided = [Dimension(0, d, p) for d in camera for p in (("",) if d == "time" else _PAIR)]
    turns: list[list[int]] = [[]]
    for number, began in sampler.requests[len(camera) :]:
        if began and turns[-1]:
            turns.append([])
        turns[-1].append(number)
    # If some paths skip random numbers, their decisions have no common order
    if len(decided) + sum(map(sum, turns)) != asked:
        rest = range(1, asked - len(decided) + 1)
        unknown = (Dimension(1, f"request {k}") for k in rest)
        return (*decided, *unknown), mean - len(decided)
    mean -= len(decided)
    integrator = find_integrator(tracer.scene, tracer.integrator)
    for bounce, turn in enumerate(turns, 1):
        names = [f"request {k}" for k in range(1, len(turn) + 1)]
        for order in _ORDERS.get(_kind(integrator), ()):
            if [number for number, _ in order] == turn:
                names = [name for _, name in order]
        for number, name in zip(turn, names, strict=True):
            decided += [Dimension(bounce, name, p) for p in (_PAIR if number == 2 else ("",))]
    return tuple(decided), mean
