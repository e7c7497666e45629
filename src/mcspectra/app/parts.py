"""From a set-up to its estimator and sampler, kept so that they keep what was computed for them."""

from __future__ import annotations

import threading
import warnings
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Literal, final

from mcspectra.app.parameters import changed
from mcspectra.app.specs import UPLOAD, techniques
from mcspectra.app.state import MOST_POINTS, Setup
from mcspectra.app.uploads import upload_path
from mcspectra.core.analysis import Analysis
from mcspectra.core.errors import ParameterError
from mcspectra.core.spec import parse
from mcspectra.densities import Density, density
from mcspectra.estimators import AbstractEstimator, Estimator, Mirrored, TechniqueSum
from mcspectra.integrands import Integrand, integrand
from mcspectra.integrands.smoothing import smoothed
from mcspectra.samplers import Sampler, sampler
from mcspectra.spectra.power import Spectrum
from mcspectra.variance.convergence import Convergence
from mcspectra.variance.terms import Terms

__all__ = ["Parts", "analyses_of", "integrand_specs", "ladder", "make_parts"]

_KEPT = 64
_FILTERS = threading.Lock()  # warning filters are the process's, not a thread's


@final
@dataclass(frozen=True)
class Parts:
    """What a set-up describes, made; `notes` are what it was warned of."""

    density: Density | None
    estimator: AbstractEstimator
    sampler: Sampler
    space: Literal["domain", "primary"]
    notes: tuple[str, ...]


def integrand_specs(setup: Setup) -> tuple[str, ...]:
    """Specs of the integrands, one for each technique, as `mcspectra.integrand` reads them.

    A file stands in the place of an upload's digest, and those of several channels have the one that
    is shown.

    Raises
    ------
    McspectraError
        A spec cannot be made, or an upload is not here.
    """
    return tuple(_resolved(text, setup) for text in techniques(setup.integrand))


def _resolved(text: str, setup: Setup) -> str:
    channel = setup.channel if setup.channel == "luminance" else int(setup.channel)
    call = parse(text)
    if call.name == UPLOAD:
        return f"image(path={str(upload_path(call.arguments['digest']))!r}, channel={channel!r})"
    if not _integrand(text, setup.dims).channels:
        return text
    return changed(text, "channel", channel)


def make_parts(setup: Setup) -> Parts:
    """Make density, estimator and sampler; the same ones for all rounds of realisations.

    Raises
    ------
    McspectraError
        A spec cannot be made, or the parts do not fit one another.
    """
    return _parts(replace(setup, realizations=2))


@lru_cache(_KEPT)
def _parts(setup: Setup) -> Parts:
    specs = integrand_specs(setup)
    p = _density(setup.density, setup.dims)
    estimator = _estimator(specs, setup.density, setup.mirror, setup.smoothing, setup.dims)
    source = sampler(setup.displaced_sampler, setup.dims)
    with _FILTERS, warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        estimator.check_sampler(source, source.check_count(setup.n))
    notes = tuple(dict.fromkeys(str(each.message) for each in heard))
    infinite = estimator.domain_integrand is None or estimator.infinite_weights
    return Parts(p, estimator, source, "primary" if infinite else "domain", notes)


@lru_cache(_KEPT)
def _estimator(
    specs: tuple[str, ...], density_spec: str, mirror: str, smoothing: float, dims: int
) -> AbstractEstimator:
    """An estimator; kept, because its integrands remember their coefficients."""
    p = _density(density_spec, dims)
    integrands = [_integrand(spec, dims) for spec in specs]
    several = next((f for f in integrands if f.channels), None)
    if several is not None:
        raise ParameterError(
            f"{several.spec} has {several.channels} channels; the explorer shows one: choose it "
            "with channel=."
        )
    if len(integrands) > 1:
        estimator = _sum(integrands, p, smoothing)
    else:
        estimator = Estimator(_smoothed(specs[0], dims, smoothing), p)
    return estimator if mirror == "none" else Mirrored(estimator, mirror)


def _sum(integrands: list[Integrand], p: Density | None, smoothing: float) -> AbstractEstimator:
    if p is not None or smoothing:
        raise ParameterError(
            "Techniques that are summed have their densities and edges inside; choose the uniform "
            "density and no smoothing."
        )
    return TechniqueSum(integrands)


@lru_cache(_KEPT)
def _density(spec: str, dims: int) -> Density | None:
    return None if spec == "uniform" else density(spec, dims)


@lru_cache(_KEPT)
def _integrand(spec: str, dims: int) -> Integrand:
    return integrand(spec, dims)


@lru_cache(_KEPT)
def _smoothed(spec: str, dims: int, width: float) -> Integrand:
    f = _integrand(spec, dims)
    return smoothed(f, width) if width else f


def analyses_of(setup: Setup) -> dict[str, Analysis]:
    """The analyses that are shown of a set-up, by the names of their tables in study files.

    Raises
    ------
    McspectraError
        The set-up cannot be made.
    """
    common: dict[str, Any] = {
        "n": setup.n,
        "half_width": setup.half_width,
        "realizations": setup.realizations,
    }
    return {
        "spectrum": Spectrum(**common, frequency_step=setup.frequency_step),
        "convergence": Convergence(counts=tuple(ladder(setup)), realizations=setup.realizations),
        "terms": Terms(**common, basis=setup.basis, space=make_parts(setup).space),
    }


def ladder(setup: Setup) -> list[int]:
    """Numbers of points of the convergence plot: ones that the sampler can do, about 4n at most."""
    source = make_parts(setup).sampler
    top = min(4 * setup.n, MOST_POINTS, source.max_count)
    asked = [round(top / 4**k) for k in range(6) if top >= 4 ** (k + 1)]
    with _FILTERS, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        possible = {source.nearest_count(count) for count in asked}
    return sorted(count for count in possible if count <= MOST_POINTS) or [setup.n]
