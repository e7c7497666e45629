"""The exhibits in the order of the slides, loaded when asked for."""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from types import MappingProxyType
from typing import cast

from mcspectra.core.errors import UnknownName, close_match_hint
from mcspectra.report.reproduction.base import ExhibitFunction

__all__ = ["EXHIBITS", "SUMMARIES", "exhibit_names", "load_exhibit"]

_PACKAGE = "mcspectra.report.reproduction"

EXHIBITS = MappingProxyType(
    {
        "estimator": f"{_PACKAGE}.estimator:exhibit",
        "power-spectra": f"{_PACKAGE}.power_spectra:exhibit",
        "variance-integral": f"{_PACKAGE}.variance_integral:exhibit",
        "real-and-integer-frequencies": f"{_PACKAGE}.real_and_integer_frequencies:exhibit",
        "closed-forms": f"{_PACKAGE}.closed_forms:exhibit",
        "homogenisation": f"{_PACKAGE}.homogenisation:exhibit",
        "homogenisation-convergence": f"{_PACKAGE}.homogenisation_convergence:exhibit",
        "strata-alignment": f"{_PACKAGE}.strata_alignment:exhibit",
        "homogenised-formula": f"{_PACKAGE}.homogenised_formula:exhibit",
        "generalised-formula": f"{_PACKAGE}.generalised_formula:exhibit",
        "importance-terms": f"{_PACKAGE}.importance_terms:exhibit",
        "phase": f"{_PACKAGE}.phase:exhibit",
        "dimensionality": f"{_PACKAGE}.dimensionality:exhibit",
        "direct-illumination": f"{_PACKAGE}.direct_illumination:exhibit",
        "veach-pictures": f"{_PACKAGE}.veach_pictures:exhibit",
        "mis-slowest": f"{_PACKAGE}.mis_slowest:exhibit",
        "environment-channels": f"{_PACKAGE}.environment_channels:exhibit",
        "mirroring": f"{_PACKAGE}.mirroring:exhibit",
        "light-smoothing": f"{_PACKAGE}.light_smoothing:exhibit",
        "importance-spectra": f"{_PACKAGE}.importance_spectra:exhibit",
        "pair-correlation": f"{_PACKAGE}.pair_correlation:exhibit",
        "bias": f"{_PACKAGE}.bias:exhibit",
    }
)
"""Name of each exhibit to ``"module:function"``."""

SUMMARIES = MappingProxyType(
    {
        "estimator": "estimator and sampling function of random, jittered, Poisson-disk points",
        "power-spectra": "power spectra of one point set and their expectation",
        "variance-integral": "variance as the integral of two power spectra, stationary samples",
        "real-and-integer-frequencies": "rates predicted at real and at integer frequencies",
        "closed-forms": "expected power of random and jittered points, exactly",
        "homogenisation": "homogenisation by shift and toroidal wrapping, step by step",
        "homogenisation-convergence": "what homogenisation does to convergence",
        "strata-alignment": "strata aligned with the integrand converge faster",
        "homogenised-formula": "the variance of homogenised samples: the power term alone",
        "generalised-formula": "three terms of the variance, cross matrices",
        "importance-terms": "first and third term under importance sampling",
        "phase": "the third term encodes phase: shifted strata",
        "dimensionality": "growth of the third term, and maps in place of its matrix",
        "direct-illumination": "light and BSDF sampling of direct illumination",
        "veach-pictures": "Veach's scene: reference, light, BSDF and multiple importance sampling",
        "mis-slowest": "multiple importance sampling follows the slowest technique",
        "environment-channels": "environment maps: importance of gray against all channels",
        "mirroring": "mirroring of the integrand and of the samples",
        "light-smoothing": "smoothed lights restore the rate",
        "importance-spectra": "power spectra of importance samples",
        "pair-correlation": "variance through the pair correlation",
        "bias": "bias of an estimator through the mean of its coefficients",
    }
)
"""Name of each exhibit to what it shows, for listings, without loading it."""


def exhibit_names(names: Sequence[str]) -> list[str]:
    """Return the names asked for, each once, in the order of the slides; all where none is given.

    Raises
    ------
    UnknownName
        There is no such exhibit; the message offers close ones.
    """
    for name in names:
        if name not in EXHIBITS:
            hint, close = close_match_hint(name, EXHIBITS, "mcspectra reproduce --list")
            raise UnknownName(f"There is no figure called {name!r}.{hint}", close)
    return [name for name in EXHIBITS if name in names or not names]


def load_exhibit(name: str) -> ExhibitFunction:
    """Return the function that makes an exhibit."""
    module, _, function = EXHIBITS[exhibit_names([name])[0]].partition(":")
    return cast("ExhibitFunction", getattr(importlib.import_module(module), function))
