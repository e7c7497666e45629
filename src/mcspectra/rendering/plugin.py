"""Our samplers as plugins of Mitsuba, for ``<sampler type="mcspectra">`` in any scene.

Mitsuba's own executable does not run Python, so it cannot load the plugin.
Use the function `render_file` or the command ``render`` instead of the executable.

Method
------
An integrator requests one or two random numbers at a time. Sets are *padded* as in pbrt:
each request for two numbers has its own two-dimensional set,
and each request for a single number has its own one-dimensional set.
The points of each set are shuffled, so that different requests are independent of each other.
The numbers of each request are as evenly spread as the sampler's points [KolligKeller2002]_.

Alternatively, the first `joint_dims` numbers of a sample come from a single *joint* set.
By default, binary nets have joint sets of `JOINT_DIMS` numbers
if ``owen`` or ``digital-shift(jitter=True)`` randomizes them.
The first pair of numbers is the position in the pixel.
The second pair of numbers is a point on the lens or on a light.
Each pair of a joint set is as evenly spread as a padded set of the same net in two dims
(see `mcspectra.samplers.nets.JoinedPairs`).
All other samplers are padded by default.
`mcspectra.rendering.variance_map` and pixels (`padding`) have the same defaults of joint sets.
The command ``python -m benchmarks scenes`` measures the effect of joint sets on five scenes.

In vectorized variants, lane i is sample i mod n of pixel ⌊i / n⌋.
Kernels compute the sets of many samplers (`kernel_sets`), also joint sets up to `_MOST_WORDS` dims.
Sets of other samplers are stored as float32 tables in Dr.Jit's memory.
The class `Rounds` assigns the sets of these tables to requests for random numbers.
In scalar variants, Mitsuba seeds the sampler for each pixel. Then the sets of the pixel are drawn.
"""

from __future__ import annotations

import functools
import importlib
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from typing import Any, final

import numpy as np

from mcspectra.core.checks import Array, as_choice, as_integer, as_joint_dims
from mcspectra.core.errors import MissingDependency, ParameterError
from mcspectra.core.fields import settle
from mcspectra.core.jit import kernel
from mcspectra.core.parallel import available_workers, map_in_order
from mcspectra.core.streams import Stream, mix_bits
from mcspectra.rendering.backend import LARGEST_SAMPLE, LOCK, import_mitsuba, load_mitsuba
from mcspectra.rendering.kernel_sets import (
    JointPoints,
    JointSets,
    Pads,
    Rounds,
    Rule,
    net_of,
    rule_of,
    shifted_net_of,
)
from mcspectra.samplers import Sampler, as_sampler
from mcspectra.samplers.nets import JoinedPairs

__all__ = [
    "FAR_APART",
    "JOINT_DIMS",
    "MOST_SAMPLES",
    "PLUGIN",
    "PLUGIN_VARIANTS",
    "LaneState",
    "PaddedSets",
    "PixelState",
    "default_spec",
    "joint_dims_of",
    "joint_sampler",
    "padded_sets",
    "register_samplers",
    "seed_lanes",
]

PLUGIN = "mcspectra"
"""Type name of the sampler in a scene."""

PLUGIN_VARIANTS = ("llvm_ad_rgb", "scalar_rgb")
"""Variants of Mitsuba that get the plugin by default."""

FAR_APART = "larcher-pillichshammer | digital-shift(jitter=True)"
"""The default sampler of paths, a net whose points are far apart. It has powers of two points.

In five scenes with 4 to 1024 samples, its variance is at most that of ``sobol | owen``, within
the errors. The exception is an environment map with 4 samples, where it has 2 % more variance.
"""

JOINT_DIMS = 4
"""Default number of joint dims of randomized binary nets.

With more joint dims, pairs of high dims are less evenly spread than padded pairs.
In a scene of a room, 8 joint dims had 10 % more variance at n = 16.
"""

_MOST_WORDS = 8  # largest number of joint dims computed in a kernel; more are stored in a table
_UNKNOWN = 2**32 - 1  # with this value, Mitsuba keeps the current size of the wavefront


def register_samplers(variant: str | Sequence[str] | None = None) -> tuple[str, ...]:
    """Register ``<sampler type="mcspectra">`` with Mitsuba; a second call has no effect.

    The plugin's properties are ``spec`` (string, by default that of `default_spec`),
    ``sample_count``, ``seed``, ``joint_dims`` and ``samples_per_pass``.
    The integer ``joint_dims`` is how many of the first numbers of a sample come from one joint set.
    With 0, every request has its own set. The default is that of `joint_dims_of`.
    The integer ``samples_per_pass`` is needed if an integrator splits the samples of a pixel.

    Parameters
    ----------
    variant
        One or several of Mitsuba's variants; by default `PLUGIN_VARIANTS`.
        The variant ``llvm_ad_rgb`` is left out of the default if there is no LLVM for it.

    Returns
    -------
    tuple of str
        Variants that have the plugin.

    Raises
    ------
    ParameterError
        If Mitsuba has no such variant.
    MissingDependency
        If Mitsuba is missing, or LLVM is missing for a requested variant.
    """
    with LOCK:
        known = import_mitsuba().variants()
        given = [variant] if isinstance(variant, str) else variant
        wanted = [as_choice("variant", v, known) for v in given or PLUGIN_VARIANTS]
        found = []
        for each in wanted:
            try:
                _plugin_class(each)
                found.append(each)
            except MissingDependency:
                if variant is not None:
                    raise
        return tuple(found)


@dataclass(frozen=True)
class _Options:
    """Options of the sampler element in a scene."""

    spec: str | None = None
    seed: int = 0
    joint_dims: int | None = None
    samples_per_pass: int = 0

    @staticmethod
    def of(properties: Any) -> _Options:
        """Read the options from the properties of a plugin."""
        default = _Options()
        return _Options(*(properties.get(name, value) for name, value in vars(default).items()))

    def sets(self, count: int) -> PaddedSets:
        """Return the point sets, each of `count` points, after checking the options."""
        most = self.samples_per_pass
        if most < 0 or (most and count % most):
            raise ParameterError(
                f"samples_per_pass is {most}; give a divisor of sample_count, {count}, or 0."
            )
        spec = self.spec
        if spec is None:
            spec = default_spec(count, joint_dims=self.joint_dims)
        return padded_sets(spec, count, self.joint_dims)

    def stream(self, seed: int) -> Stream:
        """Return the random stream of a seed."""
        base = as_integer("seed", self.seed, least=0)
        return Stream.from_rng(np.random.SeedSequence([base, seed]))


def default_spec(*counts: int, joint_dims: int | None = None) -> str:
    """Return the spec of the sampler that paths use by default, with these numbers of samples.

    It is `FAR_APART` if all counts are powers of two, and at most two pairs of dims are joint.
    Otherwise it is ``"sobol | owen"``, which has any count in any number of dims.
    """
    pairs = joint_dims in (None, 0, 2, JOINT_DIMS)
    powers = all(count & (count - 1) == 0 for count in counts)
    return FAR_APART if pairs and powers else "sobol | owen"


def joint_dims_of(sampler: Sampler) -> int:
    """Return the default number of joint dims: `JOINT_DIMS` for randomized binary nets, else 0.

    The randomization is ``owen`` or ``digital-shift(jitter=True)``.
    """
    return 0 if (net_of(sampler) or shifted_net_of(sampler)) is None else JOINT_DIMS


def joint_sampler(pair: Sampler, dims: int) -> Sampler:
    """Return a sampler of sets in more dims, for numbers that come jointly from one set.

    For `JOINT_DIMS` dims, two copies of a randomized binary net are joined (`JoinedPairs`).
    For other samplers or other numbers of dims, the sampler draws the `dims` dims by itself.
    """
    net = net_of(pair) or shifted_net_of(pair)
    if net is None or dims != JOINT_DIMS:
        return as_sampler(pair.spec, dims)
    made: Sampler = JoinedPairs(plane=net)
    for step in pair.randomizations:
        own: Any = step
        made = made.then(replace(own, base=None))
    return made


@functools.cache
def _plugin_class(variant: str) -> Any:
    """Derive a sampler class for a variant and register it; `state` holds its data."""
    mitsuba = import_mitsuba()
    if variant.startswith("llvm"):
        before = mitsuba.variant()
        load_mitsuba()  # reports a missing package or a missing LLVM
        if before is not None:
            mitsuba.set_variant(before)
    try:
        module: Any = importlib.import_module(f"mitsuba.{variant}")
    except ImportError as error:
        reason = str(error).rstrip(".")
        raise MissingDependency(
            f"Mitsuba's variant {variant} does not work here ({reason}); use "
            f"{' or '.join(PLUGIN_VARIANTS)}."
        ) from None
    seed_state: Any = PixelState.of if variant.startswith("scalar") else seed_lanes

    # Worker threads fork the sampler while the caller holds LOCK: forks must not wait for LOCK
    new_properties = import_mitsuba().Properties

    class McspectraSampler(module.Sampler):  # type: ignore[misc]
        def __init__(self, properties: Any) -> None:
            super().__init__(properties)
            self.options = _Options.of(properties)
            self.sets = self.options.sets(self.sample_count())
            self.state: LaneState | PixelState | None = None
            self.per_pass: int | None = None
            self.seeding = False

        def set_sample_count(self, spp: int) -> None:
            self.sets = self.options.sets(spp)
            super().set_sample_count(spp)

        def set_samples_per_wavefront(self, samples_per_wavefront: int) -> None:
            super().set_samples_per_wavefront(samples_per_wavefront)
            self.per_pass = samples_per_wavefront

        def seed(self, seed: Any, wavefront_size: int = _UNKNOWN) -> None:
            # `super().seed` calls this method a second time; `seeding` tells the two calls apart
            if self.seeding:
                super().seed(seed, wavefront_size)
                return
            self._seed_base(seed, wavefront_size)
            per_pass = self.per_pass or self.options.samples_per_pass or self.sets.count
            # Mitsuba's own integrators change the samples per pass without calling Python.
            # Forget the last value, which may be outdated at the next call
            self.per_pass = None
            number = int(seed) if isinstance(seed, int) else int(seed.numpy()[0])
            stream = self.options.stream(number)
            self.state = seed_state(module, self.sets, stream, self.wavefront_size(), per_pass)

        def _seed_base(self, seed: Any, wavefront_size: int) -> None:
            self.seeding = True
            try:
                super().seed(seed, wavefront_size)
            finally:
                self.seeding = False

        def fork(self) -> Any:
            properties = new_properties()
            properties["sample_count"] = self.sample_count()
            for name, value in vars(self.options).items():
                if value is not None:
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
            joint = self.sets.joint
            return (
                f"{PLUGIN}[{self.sets.spec}, joint_dims={joint}, "
                f"sample_count={self.sample_count()}]"
            )

    module.register_sampler(PLUGIN, McspectraSampler)
    return McspectraSampler


def _seeded(state: LaneState | PixelState | None) -> LaneState | PixelState:
    if state is None:
        raise ParameterError("The sampler has no seed; call seed(seed, wavefront_size) first.")
    return state


_TAKEN = ("coordinate", "single_offset", "pair_offset")
_REQUESTS = 4  # number of sets that are drawn together for one pixel
# In scalar variants of Mitsuba, the point sets repeat after this number of requests per sample.
# A request asks for one or two random numbers
_MOST_REQUESTS = 2**16


class PixelState:
    """State of the sampler at one pixel, in scalar variants."""

    def __init__(self, sets: PaddedSets, stream: Stream) -> None:
        self._sets, self._stream = sets, stream
        self._drawn: dict[tuple[int, int], Array] = {}
        self._joint: Array | None = None
        self._index = 0
        self._restart()

    @staticmethod
    def of(_: Any, sets: PaddedSets, stream: Stream, *__: int) -> PixelState:
        """Return the state of a pixel. The unused arguments are those of `seed_lanes`."""
        return PixelState(sets, stream)

    def copy(self) -> PixelState:
        """Return an independent copy of the state, which draws point sets again when needed."""
        twin = PixelState(self._sets, self._stream)
        twin._index, twin._coordinate = self._index, self._coordinate
        twin._requests = dict(self._requests)
        return twin

    def advance(self) -> None:
        """Advance to the next sample, or from the last sample to the first."""
        self._index = (self._index + 1) % self._sets.count
        self._restart()

    def schedule(self) -> None:
        """Do nothing: a scalar state needs no evaluation."""

    def single(self, _: object) -> float:
        """Return one number of the current sample."""
        return float(self._numbers(1)[0])

    def pair(self, _: object) -> tuple[float, float]:
        """Return two numbers of the current sample."""
        x, y = self._numbers(2)
        return float(x), float(y)

    def _restart(self) -> None:
        self._requests = {1: 0, 2: 0}
        self._coordinate = 0

    def _numbers(self, dims: int) -> Array:
        start, self._coordinate = self._coordinate, self._coordinate + dims
        if start + dims <= (self._sets.joint or 0):
            if self._joint is None:
                self._joint = self._sets.joints(self._stream, 0, 1)[0]
            return self._joint[self._index, start : start + dims]
        request = self._requests[dims] % _MOST_REQUESTS
        self._requests[dims] += 1
        # Sets of one stream have neighboring shifts of a mask, so each request has its own stream
        drawn = _REQUESTS if self._sets.independent else 1
        block, place = divmod(request, drawn)
        if (dims, block) not in self._drawn:
            stream = self._stream if self._sets.independent else self._stream.child(block)
            self._drawn[dims, block] = self._sets.pads(dims, stream, block * drawn, drawn)
        numbers: Array = self._drawn[dims, block][place, self._index]
        return numbers


def seed_lanes(
    module: Any, sets: PaddedSets, stream: Stream, wavefront_size: int, per_pass: int
) -> LaneState | None:
    """Return the state of a wavefront, or None for a wavefront of size 1.

    Renderers set the size to 1 to free memory.
    """
    pixels, rest = divmod(wavefront_size, per_pass)
    if rest:
        return None
    import drjit

    lane = drjit.arange(module.UInt32, wavefront_size)
    width = drjit.opaque(module.UInt32, per_pass)
    pixel = lane // width
    index = lane - pixel * width
    rules, joint_rule = sets.rules, sets.joint_rule
    pads: _TablePads | Pads
    if rules is None:
        rounds = Rounds.of(pixels, _REQUESTS, 2 * sets.count, independent=sets.independent)
        pads = _TablePads(module, sets, stream, rounds)
    else:
        pads = Pads(module, rules, sets.count, stream)
    joint: _DeviceSets | JointSets | None = None
    if joint_rule is not None:
        joint = JointSets(module, joint_rule, sets.count, stream)
    elif sets.joint:
        size = Rounds.of(pixels, _REQUESTS, 2 * sets.count).size
        joint = _DeviceSets(module, sets.joints(stream, 0, min(pixels, size)))
    return LaneState(
        module=module,
        count=sets.count,
        per_pass=per_pass,
        done=0,
        pads=pads.at(pixel, index),
        joint=None if joint is None else joint.at(pixel, index),
        pixel=pixel,
        index=index,
        **{name: module.UInt32(0) for name in _TAKEN},
    )


class _DeviceSets:
    """Point sets in Dr.Jit's memory, from a float32 array (sets, count, dims).

    This class is not a dataclass: Dr.Jit would copy the tables of a dataclass through its loops.
    """

    def __init__(self, module: Any, sets: Array) -> None:
        import drjit

        self.dims, self._numbers = sets.shape[2], module.Float(sets.ravel())
        self.size, self._count = (drjit.opaque(module.UInt32, k) for k in sets.shape[:2])

    def at(self, _: Any, __: Any) -> _DeviceSets:
        """Return this object, which holds the sets of all pixels and realizations."""
        return self

    def draw(self, dims: int, number: Any, start: Any, index: Any, active: Any) -> list[Any]:
        """Return `dims` coordinates of point `index` in set `number` modulo `size`."""
        import drjit

        first, kind = (
            ((number % self.size) * self._count + index) * self.dims + start,
            type(self._numbers),
        )
        return [drjit.gather(kind, self._numbers, first + k, active) for k in range(dims)]


class _TablePads:
    """Tables of point sets: 1-D sets answer requests for one number, 2-D sets those for two.

    The number of a set is the pixel plus an offset; each request of a pixel has a different offset.
    """

    def __init__(self, module: Any, sets: PaddedSets, stream: Stream, rounds: Rounds) -> None:
        import drjit

        self._stride = drjit.opaque(module.UInt32, rounds.stride)
        self._sets = {k: _DeviceSets(module, sets.pads(k, stream, 0, rounds.size)) for k in (1, 2)}

    def at(self, _: Any, __: Any) -> _TablePads:
        """Return this object, which holds the sets of all pixels and requests."""
        return self

    def following(self, offset: Any) -> Any:
        """Return the offset of the next request."""
        return self._wrapped(offset + self._stride)

    def draw(self, dims: int, pixel: Any, offset: Any, index: Any, active: Any) -> list[Any]:
        """Return `dims` random numbers for each lane, from the set at the given offset."""
        number = self._wrapped(pixel % self._sets[dims].size + offset)
        return self._sets[dims].draw(dims, number, 0, index, active)

    def _wrapped(self, number: Any) -> Any:
        import drjit

        size = self._sets[1].size
        return drjit.select(number >= size, number - size, number)


class _Used:
    """A number of coordinates that all lanes have used at least, known when kernels are recorded.

    Inside a recorded loop, the number of used coordinates is known only at run time.
    It is then at least the last known number before the loop, because it never decreases.
    This class is not a dataclass: Dr.Jit would carry its array through loops.
    """

    def __init__(self) -> None:
        self._known, self._bound = 0, 0
        self._last: Any = None

    def least(self, coordinate: Any) -> int:
        """Return a lower bound of a variable, the number of coordinates used."""
        known = self._is_known(coordinate)
        same = self._last is not None and coordinate.index == self._last.index
        return self._bound if same and not known else self._known

    def add(self, coordinate: Any, bound: int) -> None:
        """Store a lower bound of the variable after a request."""
        self._is_known(coordinate)
        # A copy of the variable keeps its index from being used for another variable
        self._last, self._bound = type(coordinate)(coordinate), bound

    def _is_known(self, coordinate: Any) -> bool:
        import drjit

        known: bool = coordinate.state == drjit.VarState.Literal
        if known:
            self._known = int(coordinate[0])
        return known


@dataclass
class LaneState:
    """State of a wavefront. It is a dataclass, so that Dr.Jit carries its arrays through loops.

    Each lane has a pixel, the index of its sample, and the number of coordinates it has used.
    Each lane also has the offsets of the sets that it will use next.
    The attribute `done` counts the samples of earlier passes.
    """

    module: Any
    count: int
    per_pass: int
    done: int
    pads: _TablePads | Pads
    joint: _DeviceSets | JointPoints | None
    pixel: Any
    index: Any
    coordinate: Any
    single_offset: Any
    pair_offset: Any
    used: _Used = field(default_factory=_Used)

    def copy(self) -> LaneState:
        """Return an independent copy of the state."""
        kind = self.module.UInt32
        names = ("pixel", "index", *_TAKEN)
        arrays = {name: kind(getattr(self, name)) for name in names}
        return replace(self, used=copy(self.used), **arrays)

    def advance(self) -> None:
        """Advance to the samples of the next pass."""
        zero = self.module.UInt32(0)
        self.done += self.per_pass
        self.index = self.index + self.per_pass
        self.pads = self.pads.at(self.pixel, self.index)
        if self.joint is not None:
            self.joint = self.joint.at(self.pixel, self.index)
        self.coordinate, self.single_offset, self.pair_offset = zero, zero, zero

    def schedule(self) -> None:
        """Schedule the arrays for evaluation with the next kernel."""
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

        if self.done + self.per_pass > self.count:
            raise ParameterError(
                f"All {self.count} samples of each pixel have been used; an integrator that "
                "renders in passes needs the sampler's integer samples_per_pass."
            )
        following = self.pads.following(offset)
        if self.joint is None:
            return self.pads.draw(dims, self.pixel, offset, self.index, active), following
        start, self.coordinate = self.coordinate, self.coordinate + dims
        # Do not record numbers that no lane uses
        least = self.used.least(start)
        self.used.add(self.coordinate, least + dims)
        if least + dims > self.joint.dims:
            return self.pads.draw(dims, self.pixel, offset, self.index, active), following
        if start.state == drjit.VarState.Literal:
            return self.joint.draw(dims, self.pixel, start, self.index, active), offset
        inside = start + dims <= self.joint.dims
        joint = self.joint.draw(dims, self.pixel, start, self.index, inside & active)
        pads = self.pads.draw(dims, self.pixel, offset, self.index, ~inside & active)
        values = [drjit.select(inside, a, b) for a, b in zip(joint, pads, strict=True)]
        return values, drjit.select(inside, offset, following)


MOST_SAMPLES = 2**16
"""Maximum samples per pixel. With more samples, the largest table would hold too few sets."""

_BLOCK_NUMBERS = 2**19  # numbers drawn at once (4 MiB of float64)


@kernel
def _shuffle(points: Array, keys: Array, largest: Any, out: Array) -> None:
    # Write shuffled points (R, n, d) to `out` by the inside-out Fisher-Yates method; keys (R, 2)
    for r in range(points.shape[0]):
        for i in range(points.shape[1]):
            j = int(mix_bits(keys[r, 0], keys[r, 1], i) % np.uint64(i + 1))
            for k in range(points.shape[2]):
                out[r, i, k] = out[r, j, k]
                out[r, j, k] = min(np.float32(points[r, i, k]), largest)


@final
@dataclass(frozen=True, kw_only=True)
class PaddedSets:
    """Sets of one sampler for requests of one and two numbers, and joint sets in more dims.

    `joint` is the number of dims of joint sets. Its default comes from `joint_dims_of`.
    Raises a ParameterError if the spec, the count or the dims are not possible.
    """

    spec: str
    count: int
    joint: int | None = None
    _samplers: tuple[Sampler, Sampler, Sampler | None] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        count = as_integer("sample_count", self.count, least=1, most=MOST_SAMPLES)
        pair = as_sampler(self.spec, 2)
        pair.check_count(count)
        joint = None
        if self.joint is None:
            settle(self, joint=joint_dims_of(pair))
        if self.joint:
            joint = joint_sampler(pair, as_joint_dims("joint_dims", self.joint))
            joint.check_count(count)
        try:
            single = as_sampler(self.spec, 1)
            single.check_count(count)
        except ParameterError:  # without 1-D points, use one coordinate of 2-D points
            single = pair
        settle(self, _samplers=(single, pair, joint))

    @functools.cached_property
    def rules(self) -> tuple[Rule, Rule] | None:
        """Rules for sets in one and two dims, or None if kernels cannot compute the sets."""
        single, pair = (rule_of(sampler, self.count) for sampler in self._samplers[:2])
        return None if single is None or pair is None else (single, pair)

    @functools.cached_property
    def joint_rule(self) -> Rule | None:
        """Rule for joint sets, or None if kernels cannot compute the sets."""
        joint = self._samplers[2]
        return None if joint is None or joint.dims > _MOST_WORDS else rule_of(joint, self.count)

    @property
    def independent(self) -> bool:
        """Whether sets of one stream are independent, as they are without a mask."""
        single, pair, _ = self._samplers
        return single.independent and pair.independent

    def pads(self, dims: int, stream: Stream, first: int, sets: int) -> Array:
        """Return shuffled sets in 1 or 2 dims, starting with set `first`: (sets, count, dims)."""
        sampler = self._samplers[dims - 1]
        assert sampler is not None
        return self._filled(sampler, dims, stream.child(dims), first, sets, shuffled=True)

    def joints(self, stream: Stream, first: int, sets: int) -> Array:
        """Return joint sets in the sampler's own order: float32 (sets, count, joint)."""
        sampler = self._samplers[2]
        assert sampler is not None
        return self._filled(sampler, sampler.dims, stream.child(3), first, sets, shuffled=False)

    def _filled(
        self, sampler: Sampler, dims: int, stream: Stream, first: int, sets: int, *, shuffled: bool
    ) -> Array:
        out = np.empty((sets, self.count, dims), np.float32)
        points, order = stream.child(0), stream.child(1)
        size = max(1, _BLOCK_NUMBERS // (self.count * sampler.dims))
        largest = np.float32(LARGEST_SAMPLE)

        def fill(start: int) -> None:
            part = out[start : start + size]
            drawn = sampler.draw_stream(self.count, points, first + start, len(part))[..., :dims]
            if shuffled:
                _shuffle(drawn, order.keys(first + start, len(part)), largest, part)
            else:
                np.minimum(drawn.astype(np.float32), largest, out=part)

        workers = available_workers() if sets > size else 1
        for _ in map_in_order(fill, range(0, sets, size), workers):
            pass
        return out


@functools.lru_cache(maxsize=64)
def padded_sets(spec: str, count: int, joint: int | None) -> PaddedSets:
    """Return the point sets of a sampler; an image makes several copies of its sampler object."""
    return PaddedSets(spec=spec, count=count, joint=joint)
