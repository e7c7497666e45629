"""Names of samplers and randomisations, and how any description becomes a `Sampler`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from mcspectra.core.checks import as_integer
from mcspectra.core.errors import ParameterError, SpecError, UnknownName
from mcspectra.core.registry import Registry
from mcspectra.core.spec import Call, parse_chain
from mcspectra.samplers.base import Randomization, Sampler

__all__ = ["RANDOMIZATIONS", "RUN_CODE", "SAMPLERS", "as_sampler", "sampler", "sampler_from_calls"]

SAMPLERS = Registry(
    "sampler",
    "mcspectra.samplers",
    {
        "antithetic-jittered": "mcspectra.samplers.stratified:AntitheticJittered",
        "best-candidate": "mcspectra.samplers.poisson:BestCandidate",
        "bnot": "mcspectra.samplers.relaxation:Bnot",
        "box-jitter": "mcspectra.samplers.stratified:BoxJitter",
        "command": "mcspectra.samplers.external:CommandSampler",
        "correlated-multi-jittered": "mcspectra.samplers.stratified:CorrelatedMultiJittered",
        "dart-throwing": "mcspectra.samplers.poisson:DartThrowing",
        "determinantal": "mcspectra.samplers.hyperuniform:Determinantal",
        "digital-net": "mcspectra.samplers.nets:DigitalNet",
        "farthest-point": "mcspectra.samplers.relaxation:FarthestPoint",
        "faure": "mcspectra.samplers.nets:Faure",
        "fibonacci": "mcspectra.samplers.lattice:Fibonacci",
        "gaussian-blue-noise": "mcspectra.samplers.relaxation:GaussianBlueNoise",
        "gaussian-jitter": "mcspectra.samplers.stratified:GaussianJitter",
        "halton": "mcspectra.samplers.radical:Halton",
        "hammersley": "mcspectra.samplers.radical:Hammersley",
        "hexagonal": "mcspectra.samplers.stratified:Hexagonal",
        "jittered": "mcspectra.samplers.stratified:Jittered",
        "korobov": "mcspectra.samplers.lattice:Korobov",
        "kronecker": "mcspectra.samplers.lattice:Kronecker",
        "larcher-pillichshammer": "mcspectra.samplers.nets:LarcherPillichshammer",
        "latin-hypercube": "mcspectra.samplers.orthogonal:LatinHypercube",
        "ldbn": "mcspectra.samplers.dither:LowDiscrepancyBlueNoise",
        "lloyd": "mcspectra.samplers.relaxation:Lloyd",
        "mitsuba": "mcspectra.rendering.point_sampler:MitsubaSampler",
        "multi-jittered": "mcspectra.samplers.stratified:MultiJittered",
        "n-rooks": "mcspectra.samplers.orthogonal:NRooks",
        "niederreiter": "mcspectra.samplers.nets:Niederreiter",
        "orthogonal-array": "mcspectra.samplers.orthogonal:OrthogonalArray",
        "perturbed-lattice": "mcspectra.samplers.hyperuniform:PerturbedLattice",
        "pmj": "mcspectra.samplers.progressive:PMJ",
        "pmj02": "mcspectra.samplers.progressive:PMJ02",
        "pmj02-blue-noise": "mcspectra.samplers.progressive:PMJ02BlueNoise",
        "points": "mcspectra.samplers.external:GivenPoints",
        "poisson-disk": "mcspectra.samplers.poisson:PoissonDisk",
        "projective-blue-noise": "mcspectra.samplers.projective:ProjectiveBlueNoise",
        "python": "mcspectra.samplers.external:PythonSampler",
        "qmcpy": "mcspectra.samplers.engines:QmcpySampler",
        "random": "mcspectra.samplers.stratified:Random",
        "rank1-lattice": "mcspectra.samplers.lattice:Rank1Lattice",
        "regular": "mcspectra.samplers.stratified:Regular",
        "scipy": "mcspectra.samplers.engines:ScipySampler",
        "shared-cells": "mcspectra.samplers.stratified:SharedCells",
        "sliced-optimal-transport": "mcspectra.samplers.sliced:SlicedOptimalTransport",
        "sobol": "mcspectra.samplers.nets:Sobol",
        "stealthy-hyperuniform": "mcspectra.samplers.hyperuniform:StealthyHyperuniform",
        "step-blue-noise": "mcspectra.samplers.spectral_targets:StepBlueNoise",
        "target-pcf": "mcspectra.samplers.spectral_targets:TargetPcf",
        "target-spectrum": "mcspectra.samplers.spectral_targets:TargetSpectrum",
        "uniform-jitter": "mcspectra.samplers.stratified:UniformJitter",
        "van-der-corput": "mcspectra.samplers.radical:VanDerCorput",
        "void-and-cluster": "mcspectra.samplers.dither:VoidAndCluster",
    },
    base=Sampler,
)

RUN_CODE = ("command", "python")
"""Samplers that run code of the user, which must be allowed before a spec may name it."""

RANDOMIZATIONS = Registry(
    "randomization",
    "mcspectra.randomizations",
    {
        "decorrelate": "mcspectra.samplers.randomizations:Decorrelate",
        "digital-shift": "mcspectra.samplers.scrambles:DigitalShift",
        "lms": "mcspectra.samplers.scrambles:Lms",
        "mirror": "mcspectra.samplers.randomizations:Mirror",
        "owen": "mcspectra.samplers.scrambles:Owen",
        "permute": "mcspectra.samplers.scrambles:Permute",
        "random-rotation": "mcspectra.samplers.randomizations:RandomRotation",
        "shift": "mcspectra.samplers.randomizations:Shift",
        "shuffle": "mcspectra.samplers.selection:Shuffle",
        "skip": "mcspectra.samplers.selection:Skip",
        "strata-shift": "mcspectra.samplers.randomizations:StrataShift",
        "subset": "mcspectra.samplers.selection:Subset",
    },
    base=Randomization,
)


def sampler(spec: str | Sampler, dims: int | None = None) -> Sampler:
    """Make a sampler from a spec string such as ``jittered | shift``.

    Parameters
    ----------
    spec
        A sampler, then any number of randomisations after ``|``. Everything that
        `as_sampler` accepts is accepted here too.
    dims
        Number of dims; None leaves it to the spec, else to the sampler's default (2).

    Raises
    ------
    SpecError
        The spec cannot be read, or a name is unknown (`UnknownName`) or in the wrong place.
    ParameterError
        A parameter or `dims` does not fit.
    """
    if not isinstance(spec, str):
        return as_sampler(spec, dims)
    return sampler_from_calls(parse_chain(spec), dims)


def sampler_from_calls(calls: Sequence[Call], dims: int | None = None) -> Sampler:
    """Make a sampler from a spec string already parsed (`core.spec.parse_chain`)."""
    head, *rest = calls
    made: Sampler = _built(SAMPLERS, head, _checked(dims))
    for call in rest:
        made = made.then(_built(RANDOMIZATIONS, call))
    return made


def as_sampler(source: Any, dims: int | None = None) -> Sampler:
    """Return `source` as a sampler of `dims` dims (of any number of dims if None).

    Parameters
    ----------
    source
        A sampler, a spec string, an array of points (n, d) or (R, n, d), or an engine of
        `scipy.stats.qmc`, a generator of QMCPy, or the class of one.
    dims
        Number of dims that is needed.

    Raises
    ------
    ParameterError
        `source` has another type, or another number of dims.
    """
    if isinstance(source, str):
        return sampler(source, dims)
    made = _from_object(source, _checked(dims))
    if dims is not None and made.dims != dims:
        raise ParameterError(
            f"The sampler {made.spec} is for {made.dims} dims, but {dims} dims are needed."
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
        f"{source!r} is not a sampler; give a Sampler, a spec such as 'jittered | shift', an array "
        "of points (n, d) or (R, n, d), a scipy.stats.qmc engine, a QMCPy generator, or make one of a "
        "function with Sampler.from_function."
    )


def _built(registry: Registry, call: Call, dims: int | None = None) -> Any:
    """Make a part of a chain; a name from the other registry is in the wrong place."""
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
