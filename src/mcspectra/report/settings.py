"""How the analyses of an estimator were done, and which of its samplers lack one."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

from mcspectra.report.collect import EstimatorGroup
from mcspectra.report.formatting import percent

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["missing_analyses", "settings"]

_WITHOUT_SETTINGS = ("points", "exact")  # the caption and the table have their n
_TITLES = {"pcf": "pair correlation", "anova": "axes"}


def settings(group: EstimatorGroup) -> Iterator[tuple[str, str]]:
    """How each analysis was done, once for every distinct setting."""
    for analysis in (each for each in group.analyses if each not in _WITHOUT_SETTINGS):
        samplers: dict[str, list[str]] = {}
        for sampler, each in group.having(analysis).items():
            samplers.setdefault(_setting(analysis, each), []).append(sampler)
        for text, names in samplers.items():
            yield (
                _TITLES.get(analysis, analysis),
                text if len(samplers) == 1 else f"{text} ({', '.join(names)})",
            )


def missing_analyses(group: EstimatorGroup) -> Iterator[str]:
    """Analyses that some samplers of this estimator have and others lack."""
    for analysis in group.analyses:
        there = group.having(analysis)
        lacking = [pair.sampler for pair in group.pairs if pair.sampler not in there]
        if there and lacking:
            yield f"No {analysis} results for {', '.join(lacking)}."


def _setting(analysis: str, data: xr.Dataset) -> str:
    known = data.attrs
    if "budget" in known:
        counts = f"{known['budget']} evaluations"
    elif "n" in known:
        counts = f"n = {known['n']}"
    else:
        n = data["n"].values.tolist() if "n" in data else []
        counts = f"n = {n[0]} … {n[-1]}" if len(n) > 1 else ", ".join(f"n = {k}" for k in n)
    parts = [
        *filter(None, [counts]),
        f"{known.get('realizations', '?')} realisations{_stopping(known)}",
    ]
    if analysis == "convergence":
        parts += _fit_setting(known)
    if analysis == "terms":
        parts += [f"{known['basis']} basis"] if "basis" in known else []
        parts += [f"half width {data.sizes['half_width'] - 1}", f"{known.get('space', '?')} space"]
        parts += [f"coefficients: {known['coefficients']}"] if "coefficients" in known else []
    return ", ".join(parts)


def _stopping(known: Mapping[Any, Any]) -> str:
    if "relative_error" not in known:
        return ""
    error = percent(float(known["relative_error"]))
    return f" at most, fewer where the variance has a standard error of {error}"


def _fit_setting(known: Mapping[Any, Any]) -> Iterator[str]:
    if known.get("fit_window") == "auto":
        yield "rates fitted to as many of the last counts as lie on a line"
    elif "fit_last" in known:
        yield f"rates fitted to the last {known['fit_last']} counts"
