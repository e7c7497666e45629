"""Our samplers as plugins of Mitsuba: ``<sampler type="mcspectra">`` in any scene.

In vectorised variants all sets are tables in Dr.Jit's memory: lane i is sample i mod n of pixel
⌊i / n⌋, and requests are gathered from the sets that `Rounds` lays out. In scalar ones Mitsuba
seeds the sampler for each pixel, whose sets are then drawn. Mitsuba's own executable runs no Python
and so cannot know the plugin: `render_file` and the verb ``mitsuba`` take its place.
"""

from __future__ import annotations

import functools
import importlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mcspectra.core.checks import Array, as_choice, as_integer
from mcspectra.core.errors import MissingDependency, ParameterError
from mcspectra.core.streams import Stream
from mcspectra.rendering.backend import LOCK, import_mitsuba, load_mitsuba
from mcspectra.rendering.sample_tables import PaddedSets, Rounds

__all__ = ["PLUGIN", "PLUGIN_VARIANTS", "register_samplers"]

PLUGIN = "mcspectra"
"""Type of the sampler in a scene."""

PLUGIN_VARIANTS = ("llvm_ad_rgb", "scalar_rgb")
"""Variants of Mitsuba for which the plugin is made by default."""

_REQUESTS = 4  # sets of each pixel that no other has: film, light, BSDF and one more
_UNKNOWN = 2**32 - 1  # Mitsuba's wavefront size for "as before"
_MOST_REQUESTS = 2**16  # of a pixel, in scalar variants


def register_samplers(variant: str | Sequence[str] | None = None) -> tuple[str, ...]:
    """Make ``<sampler type="mcspectra">`` known to Mitsuba; to do it again changes nothing.

    The plugin's properties are ``spec`` (string, default ``"sobol | owen"``), ``sample_count``,
    ``seed``, ``joint_dims`` (integer: the first so many coordinates of a sample come from one set
    in as many dims; 0, the default, pads every request with a set of its own) and
    ``samples_per_pass`` (integer: needed if the integrator splits a pixel's samples over passes).

    Parameters
    ----------
    variant
        One of Mitsuba's variants or several; by default `PLUGIN_VARIANTS`, without ``llvm_ad_rgb``
        if there is no LLVM for it.

    Returns
    -------
    tuple of str
        The variants that know the plugin.

    Raises
    ------
    ParameterError
        Mitsuba has no such variant.
    MissingDependency
        Mitsuba is missing, or LLVM for a variant that was asked for.
    """
    with LOCK:
        known = import_mitsuba().variants()
        given = [variant] if isinstance(variant, str) else variant
        wanted = [as_choice("variant", v, known) for v in given or PLUGIN_VARIANTS]
        return tuple(v for v in wanted if _register(v, needed=variant is not None))


def _register(variant: str, *, needed: bool) -> bool:
    try:
        _plugin_class(variant)
    except MissingDependency:
        if needed:
            raise
        return False
    return True


@functools.cache
def _plugin_class(variant: str) -> Any:
    """Make the class for one variant and register it."""
    mitsuba = import_mitsuba()
    if variant.startswith("llvm"):
        before = mitsuba.variant()
        load_mitsuba()  # looks for LLVM, and says what is missing
        if before is not None:
            mitsuba.set_variant(before)
    module = _module(variant)
    made = _class_for(module, _seed_pixel if variant.startswith("scalar") else _seed_lanes)
    module.register_sampler(PLUGIN, made)
    return made


def _module(variant: str) -> Any:
    try:
        return importlib.import_module(f"mitsuba.{variant}")
    except ImportError as error:
        reason = str(error).rstrip(".")
        raise MissingDependency(
            f"Mitsuba's variant {variant} does not work here ({reason}); use "
            f"{' or '.join(PLUGIN_VARIANTS)}."
        ) from None


@dataclass(frozen=True)
class _Options:
    """What a scene says of the sampler."""

    spec: str = "sobol | owen"
    seed: int = 0
    joint_dims: int = 0
    samples_per_pass: int = 0

    @staticmethod
    def of(properties: Any) -> _Options:
        """Read a plugin's properties."""
        default = _Options()
        return _Options(*(properties.get(name, value) for name, value in vars(default).items()))

    def sets(self, count: int) -> PaddedSets:
        """Sets of `count` points, which are checked."""
        most = self.samples_per_pass
        if most < 0 or (most and count % most):
            raise ParameterError(
                f"samples_per_pass is {most}; give a divisor of sample_count, {count}, or 0."
            )
        return PaddedSets(spec=self.spec, count=count, joint=self.joint_dims)

    def stream(self, seed: int) -> Stream:
        """Random stream of one seeding."""
        base = as_integer("seed", self.seed, least=0)
        return Stream.from_rng(np.random.SeedSequence([base, seed]))


def _class_for(module: Any, seed_state: Any) -> Any:
    """Derive from the variant's `Sampler`; all state but the numbers of samples is in `state`."""

    # Workers of Mitsuba fork the sampler while the caller holds LOCK, which is not for them.
    new_properties = import_mitsuba().Properties

    class McspectraSampler(module.Sampler):  # type: ignore[misc]
        def __init__(self, properties: Any) -> None:
            super().__init__(properties)
            self.options = _Options.of(properties)
            self.sets = self.options.sets(self.sample_count())
            self.state: _Lanes | _Pixel | None = None
            self.per_pass: int | None = None
            self.seeding = False

        def set_sample_count(self, spp: int) -> None:
            self.sets = self.options.sets(spp)
            super().set_sample_count(spp)

        def set_samples_per_wavefront(self, samples_per_wavefront: int) -> None:
            super().set_samples_per_wavefront(samples_per_wavefront)
            self.per_pass = samples_per_wavefront

        def seed(self, seed: Any, wavefront_size: int = _UNKNOWN) -> None:
            if not self.seeding:
                self._seed_base(seed, wavefront_size)
                self._seed_state(seed)
            else:  # by the base class, which calls what overrides it if Python called it
                super().seed(seed, wavefront_size)

        def _seed_base(self, seed: Any, wavefront_size: int) -> None:
            self.seeding = True
            try:
                super().seed(seed, wavefront_size)
            finally:
                self.seeding = False

        def _seed_state(self, seed: Any) -> None:
            per_pass = self.per_pass or self.options.samples_per_pass or self.sets.count
            # Mitsuba's own integrators set the samples of a pass where Python cannot see it.
            self.per_pass = None
            stream = self.options.stream(_as_int(seed))
            self.state = seed_state(module, self.sets, stream, self.wavefront_size(), per_pass)

        def fork(self) -> Any:
            properties = new_properties()
            properties["sample_count"] = self.sample_count()
            for name, value in vars(self.options).items():
                properties[name] = value
            return type(self)(properties)

        def clone(self) -> Any:
            twin = self.fork()
            if self.state is not None:
                twin._seed_base(0, self.wavefront_size())
                twin.state = self.state.copy()
            return twin

        def next_1d(self, active: Any = True) -> Any:
            return _seeded(self.state).single(active)

        def next_2d(self, active: Any = True) -> Any:
            return module.Point2f(*_seeded(self.state).pair(active))

        def advance(self) -> None:
            _seeded(self.state).advance()

        def schedule_state(self) -> None:
            _seeded(self.state).schedule()

        def to_string(self) -> str:
            return f"{PLUGIN}[{self.sets.spec}, sample_count={self.sample_count()}]"

    return McspectraSampler


def _seeded(state: _Lanes | _Pixel | None) -> _Lanes | _Pixel:
    if state is None:
        raise ParameterError("The sampler has no seed; call seed(seed, wavefront_size) first.")
    return state


def _as_int(seed: Any) -> int:
    """Return a seed of a vectorised variant, an array of one number, or of a scalar one."""
    return int(seed) if isinstance(seed, int) else int(seed.numpy()[0])


def _seed_pixel(_: Any, sets: PaddedSets, stream: Stream, *__: int) -> _Pixel:
    return _Pixel(sets, stream)


class _Pixel:
    """State of one pixel of a scalar variant."""

    def __init__(self, sets: PaddedSets, stream: Stream) -> None:
        self._sets, self._stream = sets, stream
        self._drawn: dict[tuple[int, int], Array] = {}
        self._joint: Array | None = None
        self._index = 0
        self._restart()

    def copy(self) -> _Pixel:
        """Return a state that goes on by itself; sets are drawn anew when it asks for them."""
        twin = _Pixel(self._sets, self._stream)
        twin._index, twin._coordinate = self._index, self._coordinate
        twin._requests = dict(self._requests)
        return twin

    def advance(self) -> None:
        """Go on to the next sample, after the last one to the first."""
        self._index = (self._index + 1) % self._sets.count
        self._restart()

    def schedule(self) -> None:
        """Do nothing: there is nothing to evaluate."""

    def single(self, _: object) -> float:
        """Return one number."""
        return float(self._numbers(1)[0])

    def pair(self, _: object) -> tuple[float, float]:
        """Return two numbers."""
        x, y = self._numbers(2)
        return float(x), float(y)

    def _restart(self) -> None:
        self._requests = {1: 0, 2: 0}
        self._coordinate = 0

    def _numbers(self, dims: int) -> Array:
        start, self._coordinate = self._coordinate, self._coordinate + dims
        if start + dims <= self._sets.joint:
            if self._joint is None:
                self._joint = self._sets.joints(self._stream, 0, 1)[0]
            return self._joint[self._index, start : start + dims]
        request = self._requests[dims] % _MOST_REQUESTS
        self._requests[dims] += 1
        block, place = divmod(request, _REQUESTS)
        if (dims, block) not in self._drawn:
            pads = self._sets.pads(dims, self._stream, block * _REQUESTS, _REQUESTS)
            self._drawn[dims, block] = pads
        numbers: Array = self._drawn[dims, block][place, self._index]
        return numbers


def _seed_lanes(
    module: Any, sets: PaddedSets, stream: Stream, wavefront_size: int, per_pass: int
) -> _Lanes | None:
    """State of a wavefront, None if it is none: renderers let go of memory by a wavefront of 1."""
    pixels, rest = divmod(wavefront_size, per_pass)
    if rest:
        return None
    import drjit

    lane = drjit.arange(module.UInt32, wavefront_size)
    width = drjit.opaque(module.UInt32, per_pass)
    tables = _Tables(module, sets, stream, pixels)
    zeros = (drjit.opaque(module.UInt32, 0) for _ in range(3))
    return _Lanes(tables, per_pass, 0, lane // width, lane % width, *zeros)


class _Tables:
    """Sets in Dr.Jit's memory. No dataclass: Dr.Jit would make tables part of a loop's state."""

    def __init__(self, module: Any, sets: PaddedSets, stream: Stream, pixels: int) -> None:
        import drjit

        self.module, self.sets = module, sets
        self.rounds = Rounds.of(pixels, _REQUESTS, 2 * sets.count)
        self._count = drjit.opaque(module.UInt32, sets.count)
        self._size = drjit.opaque(module.UInt32, self.rounds.size)
        self._stride = drjit.opaque(module.UInt32, self.rounds.stride)
        self._pads = {
            dims: module.Float(sets.pads(dims, stream, 0, self.rounds.size).ravel())
            for dims in (1, 2)
        }
        if sets.joint:
            own = min(pixels, self.rounds.size)
            self._joint = module.Float(sets.joints(stream, 0, own).ravel())
            self._joint_size = drjit.opaque(module.UInt32, own)

    def next_offset(self, offset: Any) -> Any:
        """Offset of the next request."""
        return self._wrapped(offset + self._stride)

    def pad(self, dims: int, pixel: Any, offset: Any, index: Any, active: Any) -> list[Any]:
        """Numbers of requests with this offset."""
        row = self._wrapped(pixel % self._size + offset) * self._count + index
        return self._row(self._pads[dims], dims, row * dims, active)

    def joint(self, dims: int, pixel: Any, start: Any, index: Any, active: Any) -> list[Any]:
        """Coordinates from `start` on of the pixel's joint set."""
        row = (pixel % self._joint_size) * self._count + index
        return self._row(self._joint, dims, row * self.sets.joint + start, active)

    def _wrapped(self, number: Any) -> Any:
        import drjit

        return drjit.select(number >= self._size, number - self._size, number)

    def _row(self, table: Any, dims: int, first: Any, active: Any) -> list[Any]:
        import drjit

        return [drjit.gather(self.module.Float, table, first + k, active) for k in range(dims)]


@dataclass
class _Lanes:
    """State of a wavefront: a dataclass, so that Dr.Jit carries its arrays through loops.

    Attributes
    ----------
    tables, per_pass, done
        Points, samples of a pixel in a pass, and samples of a pixel in passes before.
    pixel, index
        Of each lane.
    coordinate, single_offset, pair_offset
        What a sample has taken so far: numbers, and where its next sets are.
    """

    tables: _Tables
    per_pass: int
    done: int
    pixel: Any
    index: Any
    coordinate: Any
    single_offset: Any
    pair_offset: Any

    def copy(self) -> _Lanes:
        """Return a state that goes on by itself."""
        kind = self.tables.module.UInt32
        names = ("pixel", "index", "coordinate", "single_offset", "pair_offset")
        return replace(self, **{name: kind(getattr(self, name)) for name in names})

    def advance(self) -> None:
        """Go on to the samples of the next pass."""
        zero = self.tables.module.UInt32(0)
        self.done += self.per_pass
        self.index = self.index + self.per_pass
        self.coordinate, self.single_offset, self.pair_offset = zero, zero, zero

    def schedule(self) -> None:
        """Have the arrays evaluated with the next kernel."""
        import drjit

        drjit.schedule(self.index, self.coordinate, self.single_offset, self.pair_offset)

    def single(self, active: Any) -> Any:
        """Return one number for each lane."""
        (value,), self.single_offset = self._numbers(1, self.single_offset, active)
        return value

    def pair(self, active: Any) -> list[Any]:
        """Return two numbers for each lane."""
        values, self.pair_offset = self._numbers(2, self.pair_offset, active)
        return values

    def _numbers(self, dims: int, offset: Any, active: Any) -> tuple[list[Any], Any]:
        import drjit

        self._check()
        start, self.coordinate = self.coordinate, self.coordinate + dims
        following = self.tables.next_offset(offset)
        if not self.tables.sets.joint:
            return self.tables.pad(dims, self.pixel, offset, self.index, active), following
        inside = start + dims <= self.tables.sets.joint
        joint = self.tables.joint(dims, self.pixel, start, self.index, inside & active)
        pads = self.tables.pad(dims, self.pixel, offset, self.index, ~inside & active)
        values = [drjit.select(inside, a, b) for a, b in zip(joint, pads, strict=True)]
        return values, drjit.select(inside, offset, following)

    def _check(self) -> None:
        if self.done + self.per_pass > self.tables.sets.count:
            raise ParameterError(
                f"All {self.tables.sets.count} samples of each pixel are used; an integrator that "
                "renders in passes needs the sampler's integer samples_per_pass."
            )
