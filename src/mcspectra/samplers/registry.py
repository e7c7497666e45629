"""Names of samplers and randomizations, and conversion of other objects to a `Sampler`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from mcspectra.core.checks import as_integer
from mcspectra.core.display import counted, needed, shown
from mcspectra.core.errors import ParameterError, SpecError, UnknownName
from mcspectra.core.registry import Registry, classes_of
from mcspectra.core.spec import Call, parse_chain
from mcspectra.core.trust import CODE
from mcspectra.samplers.base import Randomization, Sampler

__all__ = ["RANDOMIZATIONS", "RUN_CODE", "SAMPLERS", "as_sampler", "sampler", "sampler_from_calls"]

SAMPLERS = Registry(
    "sampler",
    "mcspectra.samplers",
    classes_of(
        {
            "rendering.point_sampler": "mitsuba=MitsubaSampler",
            "samplers.dither": "ldbn=LowDiscrepancyBlueNoise VoidAndCluster",
            "samplers.engines": "qmcpy=QmcpySampler scipy=ScipySampler",
            "samplers.external": "command=CommandSampler points=GivenPoints python=PythonSampler",
            "samplers.hyperuniform": "Determinantal PerturbedLattice StealthyHyperuniform",
            "samplers.lattice": "Fibonacci Korobov Kronecker Rank1Lattice",
            "samplers.nets": "DigitalNet Faure LarcherPillichshammer Niederreiter Sobol",
            "samplers.orthogonal": "LatinHypercube n-rooks=NRooks OrthogonalArray",
            "samplers.poisson": "BestCandidate DartThrowing PoissonDisk",
            "samplers.progressive": "PMJ PMJ02 PMJ02BlueNoise",
            "samplers.projective": "ProjectiveBlueNoise",
            "samplers.radical": "Halton Hammersley VanDerCorput",
            "samplers.relaxation": "Bnot FarthestPoint GaussianBlueNoise Lloyd",
            "samplers.sliced": "SlicedOptimalTransport",
            "samplers.spectral_targets": "StepBlueNoise TargetPcf TargetSpectrum",
            "samplers.stratified": "AntitheticJittered BoxJitter CorrelatedMultiJittered "
            "GaussianJitter Hexagonal Jittered MultiJittered Random Regular SharedCells "
            "UniformJitter",
        }
    ),
    base=Sampler,
)

RUN_CODE = tuple(CODE)
"""Samplers that run the user's code. A spec may name only code that the user has allowed."""

RANDOMIZATIONS = Registry(
    "randomization",
    "mcspectra.randomizations",
    classes_of(
        {
            "samplers.randomizations": "Decorrelate Mirror RandomRotation Shift StrataShift",
            "samplers.scrambles": "DigitalShift Lms Owen Permute",
            "samplers.selection": "Shuffle Skip Subset",
        }
    ),
    base=Randomization,
)


def sampler(spec: str | Sampler, dims: int | None = None) -> Sampler:
    """Make a sampler from a spec string such as ``jittered | shift``.

    Parameters
    ----------
    spec
        A sampler, followed by any number of randomizations, each after a ``|``.
        Everything that `as_sampler` accepts is also accepted.
    dims
        Number of dims. With None the spec decides, or else the sampler's default (2).

    Raises
    ------
    SpecError
        If the spec cannot be read, or a name is unknown (`UnknownName`) or in the wrong place.
    ParameterError
        If a parameter or `dims` is not allowed.
    """
    if not isinstance(spec, str):
        return as_sampler(spec, dims)
    return sampler_from_calls(parse_chain(spec), dims)


def sampler_from_calls(calls: Sequence[Call], dims: int | None = None) -> Sampler:
    """Make a sampler from a parsed spec string (`core.spec.parse_chain`)."""
    head, *rest = calls
    made: Sampler = _built(SAMPLERS, head, _checked(dims))
    for call in rest:
        made = made.then(_built(RANDOMIZATIONS, call))
    return made


def as_sampler(source: Any, dims: int | None = None) -> Sampler:
    """Convert a source of points to a sampler with `dims` dims (any number of dims if None).

    Parameters
    ----------
    source
        A sampler, a spec string, or an array of points (n, d) or (R, n, d).
        Engines of `scipy.stats.qmc`, generators of QMCPy, and their classes are also accepted.
    dims
        Required number of dims.

    Raises
    ------
    ParameterError
        If `source` has a wrong type or a wrong number of dims.
    """
    if isinstance(source, str):
        return sampler(source, dims)
    made = _from_object(source, _checked(dims))
    if dims is not None and made.dims != dims:
        raise ParameterError(
            f"The sampler {made.spec} is for {counted(made.dims, 'dim')}, "
            f"but {needed(dims, 'dim')}."
        )
    return made


def _checked(dims: object) -> int | None:
    return None if dims is None else as_integer("dims", dims, least=1)


def _from_object(source: Any, dims: int | None) -> Sampler:
    from mcspectra.samplers.engines import is_engine, is_generator

    if isinstance(source, Sampler):
        return source
    nested = isinstance(source, list | tuple) and source and isinstance(source[0], list | tuple)
    if isinstance(source, np.ndarray) or nested:
        return Sampler.from_points(source)
    sized = isinstance(source, type) and dims is not None
    if is_engine(source):
        return Sampler.from_scipy(source, **({"d": dims} if sized else {}))
    if is_generator(source):
        return Sampler.from_qmcpy(source, **({"dims": dims} if sized else {}))
    raise ParameterError(
        f"{shown(source)} is not a sampler; give a Sampler, a spec such as 'jittered | shift', "
        "an array of points (n, d) or (R, n, d), a scipy.stats.qmc engine, a QMCPy generator, "
        "or make one of a function with Sampler.from_function."
    )


def _built(registry: Registry, call: Call, dims: int | None = None) -> Any:
    """Build a sampler or a randomization from a call.

    If a spec has a randomization in the place of a sampler, the error message says so.
    A sampler in the place of a randomization also has its own error message.
    """
    first = registry is SAMPLERS
    if first and call.name in RUN_CODE:
        from mcspectra.samplers.external import check_code

        check_code(call)
    try:
        return registry.build(call, dims)
    except UnknownName:
        if first and call.name in RANDOMIZATIONS:
            raise SpecError(
                f"{call.name!r} is a randomization, not a sampler; write a sampler before it, "
                f"as in 'jittered | {call.name}'."
            ) from None
        if not first and call.name in SAMPLERS:
            raise SpecError(
                f"{call.name!r} is a sampler, not a randomization; only the first part of a chain "
                f"is a sampler, after '|' come {', '.join(RANDOMIZATIONS)}."
            ) from None
        raise
