"""Our samplers as plugins of Mitsuba: ``<sampler type="mcspectra">`` in any scene.

Mitsuba's own executable runs no Python and so cannot know the plugin: `render_file` and the verb
``mitsuba`` take its place.
"""

from __future__ import annotations

import functools
import importlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mcspectra.core.checks import as_choice, as_integer
from mcspectra.core.errors import MissingDependency, ParameterError
from mcspectra.core.streams import Stream
from mcspectra.rendering.backend import LOCK, import_mitsuba, load_mitsuba
from mcspectra.rendering.plugin_state import LaneState, PixelState, seed_lanes, seed_pixel
from mcspectra.rendering.sample_tables import PaddedSets

__all__ = ["PLUGIN", "PLUGIN_VARIANTS", "register_samplers"]

PLUGIN = "mcspectra"
"""Type of the sampler in a scene."""

PLUGIN_VARIANTS = ("llvm_ad_rgb", "scalar_rgb")
"""Variants of Mitsuba for which the plugin is made by default."""

_UNKNOWN = 2**32 - 1  # Mitsuba's wavefront size for "as before"


def register_samplers(variant: str | Sequence[str] | None = None) -> tuple[str, ...]:
    """Register ``<sampler type="mcspectra">`` with Mitsuba; a second call changes nothing.

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
    made = _class_for(module, seed_pixel if variant.startswith("scalar") else seed_lanes)
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
    """Options of the sampler in a scene."""

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


def _seeded(state: LaneState | PixelState | None) -> LaneState | PixelState:
    if state is None:
        raise ParameterError("The sampler has no seed; call seed(seed, wavefront_size) first.")
    return state


def _as_int(seed: Any) -> int:
    """Return a seed of a vectorised variant, an array of one number, or of a scalar one."""
    return int(seed) if isinstance(seed, int) else int(seed.numpy()[0])
