"""Sentences about a result, derived from its numbers. Their intervals limit what is claimed."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
import xarray as xr

from mcspectra.core.checks import as_instance
from mcspectra.core.confidence import CONFIDENCE_Z
from mcspectra.core.fits import UNRESOLVED, is_resolved
from mcspectra.improve.answers import Answer, CandidateResult, Verdict
from mcspectra.plots.text import NEGLIGIBLE, number, percent, rate, with_error
from mcspectra.studies import SummaryRow

__all__ = [
    "Size",
    "answer",
    "basis_name",
    "bottleneck",
    "compared",
    "explain",
    "further_sentences",
    "headline",
]

_DOMINANT = 0.9  # mention the dc term above this share of the sum of dc and power terms
_AWAY = 4.0  # two means differ if they are more than 4 standard errors apart
_LENGTH = "|\u2060m|\u2060"  # word joiners prevent a line break after a bar
_CLOSE = 0.1  # prediction and measurement are close up to this relative difference
# A page makes dozens of claims, of which some would be wrong with 95 % intervals.
# This factor widens the interval of a rate to 3 standard errors
_RATE_MARGIN = 1.5
# A rate near −1 is called the rate of random sampling only if its error is below this limit
_SURE = 0.2
_REMEDY_WORDS = ("diagnosis", "answer")
_TERMS = {
    "dc": "weights: p does not follow f",
    "power": "detail at frequencies where the sampler is noisy",
    "cross": "correlation of frequencies",
}


@dataclass(frozen=True)
class Size:
    """Variance of a set-up, the ends of its 95 % interval, its rate (NaN if unknown) and mean."""

    variance: float
    low: float
    high: float
    rate: float = math.nan
    mean: float = math.nan
    mean_se: float = math.inf


def compared(sizes: Mapping[str, Size], given: str, evaluations: int, why: str = "") -> Answer:
    """Recommend the set-up with the least variance, if it is significantly below the given one.

    Parameters
    ----------
    sizes
        Variances at equal evaluations, by name of the set-up.
    given
        Set-up with which the other set-ups are compared.
        A set-up with a different mean or with zero variance has no gain: its verdict is undecided.
    evaluations
        Number of function evaluations per estimate.
    why
        Sentences on the causes of the noise.
    """
    start, results = sizes[given], list[CandidateResult]()
    for name, size in sorted(sizes.items(), key=lambda item: (item[0] != given, item[1].variance)):
        low, high = (math.sqrt(max(end, 0.0)) for end in (size.low, size.high))
        same = not abs(size.mean - start.mean) > _AWAY * math.hypot(size.mean_se, start.mean_se)
        known = size.variance > 0.0 and same
        ratios = (
            (start.variance, size.variance),
            (start.low, size.high),
            (start.high, size.low),
        )
        gain, least, most = (a / b if known and b > 0.0 else math.nan for a, b in ratios)

        def needed(gain: float) -> float:
            """Return how many evaluations the given set-up needs for the same variance."""
            with_rate = start.rate < 0.0 and gain > 0.0
            return evaluations * gain ** (-1.0 / start.rate) if with_rate else math.nan

        verdict: Verdict = "better" if least > 1.0 else "worse" if most < 1.0 else "undecided"
        results.append(
            CandidateResult(
                name,
                f"use {name}",
                ("", name),
                evaluations,
                math.sqrt(size.variance),
                (low, high),
                gain=gain,
                gain_ci=(least, most),
                rate=size.rate,
                needed=needed(gain),
                needed_ci=(needed(least), needed(most)),
                verdict="given" if name == given else verdict,
            )
        )
    named = why and not why.startswith("No ")
    cause = f"Cause: {why[:1].lower()}{why[1:]}" if named else ""
    return Answer.of(evaluations, results, why=cause)


def answer(curves: Mapping[str, xr.Dataset], given: str = "", why: str = "") -> Answer | None:
    """Recommend a set-up, at the largest number of points that all set-ups reach.

    Parameters
    ----------
    curves
        Results of `convergence` by set-up, without channels; n counts the points of all techniques.
    given
        Set-up with which the other set-ups are compared. Default: random points, or else the first.
    why
        Sentences on the causes of the noise of the given set-up.

    Returns
    -------
    Answer
        None if there are fewer than two set-ups.
    """
    if len(curves) < 2:
        return None
    given = given or ("random" if "random" in curves else next(iter(curves)))
    n = min(int(curve["n"][-1]) for curve in curves.values())
    sizes, tiny = {}, np.finfo(float).tiny
    for name, curve in curves.items():
        # Interpolate the variance and its interval linearly in log n and log variance
        last, x = curve.isel(n=-1), np.log(curve["n"].values)
        ends = (curve["variance"], *(curve["variance_ci"].isel(bound=b) for b in (0, 1)))
        middle, low, high = (
            math.exp(np.interp(math.log(n), x, np.log(np.maximum(end.values, tiny))))
            for end in ends
        )
        if not float(last["variance"]) > 0.0:
            middle = low = high = 0.0
        sizes[name] = Size(
            middle,
            low,
            high,
            rate=float(curve.get("rate", math.nan)),
            mean=float(last["mean"]),
            mean_se=float(last.get("mean_se", math.inf)),
        )
    return compared(sizes, given, n, why)


def explain(row: SummaryRow, terms: xr.Dataset | None = None) -> str:
    """Explain the numbers of one estimator and sampler in a few sentences.

    Parameters
    ----------
    row
        Summary of the estimator and sampler.
    terms
        Result of `variance_terms` (with one channel), or None.

    Returns
    -------
    str
        Sentences about the rate of convergence, the predicted variance and the variance terms.
        One sentence gives the share of the measured variance that the spectrum accounts for.
        The text is empty if nothing is known about this estimator with this sampler.

    Raises
    ------
    ParameterError
        If `row` is not a SummaryRow, or `terms` is not a Dataset.

    Notes
    -----
    A term is said to add or remove variance only if its 95 % interval excludes 0.
    The intervals of prediction and measurement are treated as independent.
    The difference is known more precisely, because both numbers come from the same realizations.
    """
    as_instance("row", row, SummaryRow, "a row of mcspectra.studies.summarize")
    as_instance("terms", terms, xr.Dataset | None, "a dataset of mcspectra.variance_terms")
    sentences = [_rate_sentence(row)]
    if _is_predicted(row):
        half = (
            None if row.ratio_low is None else 0.5 * ((row.ratio_high or math.inf) - row.ratio_low)
        )
        shown = with_error(row.ratio, half)
        sentences.append(f"Predicted / measured variance is {shown} ({row.method}).")
    sentences += () if terms is None else _term_sentences(row, terms)
    return " ".join(sentence for sentence in sentences if sentence)


def headline(row: SummaryRow, terms: xr.Dataset | None = None, rows: int = 1) -> str:
    """Return a sentence on the rate, and on a prediction that disagrees with the measurement.

    Prediction and measurement disagree if the interval of their ratio excludes 1.
    The intervals hold simultaneously for all `rows` rows of a table [Sidak1967]_.
    """
    if row.note:
        return f"{row.note[:1].upper()}{row.note[1:]}."
    parts = [_verdict(row)]
    if row.ratio is not None and _is_predicted(row):
        wider = NormalDist().inv_cdf(0.5 + 0.5 * 0.95 ** (1.0 / rows)) / CONFIDENCE_Z
        low, high = (
            row.ratio * (end / row.ratio) ** wider if row.ratio else end
            for end in (row.ratio_low or 0.0, row.ratio_high or math.inf)
        )
        agrees = abs(row.ratio - 1.0) <= _CLOSE or low <= 1.0 <= high
        parts.append("prediction agrees" if agrees else f"predicted × {number(row.ratio)}")
    elif terms is not None and row.captured is not None and row.predicted is not None:
        width, found = terms.sizes.get("half_width", 1) - 1, _agreement(row, terms)
        basis = basis_name(row.basis)
        if found == "more":
            cure = "" if basis != "Fourier" else " (basis = 'auto' fits the sampler)"
            parts.append(f"the {basis} sum has not converged at half width {width}{cure}")
        elif found == "less":
            share = percent(1.0 - row.captured)
            parts.append(f"{share} of the variance is beyond half width\u00a0{width}")
        elif row.cross_high is not None and row.cross_high < 0:
            parts.append(f"correlation removes {_cross_share(row)} of dc + power")
        elif row.cross_low is not None and row.cross_low > 0:
            parts.append(f"correlation adds {_cross_share(row)} to dc + power")
        elif found == "agrees":
            parts.append("prediction agrees")
        elif found:
            parts.append(f"predicts {percent(row.captured)}, but its interval contains 100 %")
    text = "; ".join(part for part in parts if part)
    return f"{text[:1].upper()}{text[1:]}." if text else ""


def bottleneck(row: SummaryRow, terms: xr.Dataset | None = None, technique: str = "") -> str:
    """Name the largest source of variance: a technique, the weights, or frequencies of f."""
    if technique:
        return technique
    sizes = {"dc": row.dc, "power": row.power, "cross": row.cross}
    adding = {name: value for name, value in sizes.items() if value is not None and value > 0}
    if not adding:
        return ""
    largest = max(adding, key=lambda name: adding[name])
    half = _median_frequency(row, terms) if largest == "power" and terms is not None else None
    if half is None or row.terms_n is None or terms is None:
        return _TERMS[largest]
    # Strata of n points in d dims have the width n^(-1/d), which is the frequency n^(1/d).
    # Frequencies below n^(1/d)/4 are called coarse, for all samplers.
    dims = sum(str(dim).startswith("m") and str(dim)[1:].isdigit() for dim in terms.dims)
    if half <= 0.25 * row.terms_n ** (1.0 / max(dims, 1)):
        return f"coarse shape ({_LENGTH}\u00a0≤\u00a0{half:.2g})"
    return f"edges and detail ({_LENGTH}\u00a0≥\u00a0{half:.2g})"


def further_sentences(analyses: Mapping[str, xr.Dataset]) -> str:
    """Return stored sentences: notes, the best remedy, and why there is no exact variance."""
    curve, remedies, known = (analyses.get(k) for k in ("convergence", "remedies", "predict"))
    note = "" if curve is None else str(curve.attrs.get("note", ""))
    found: list[str | None] = [f"{note[:1].upper()}{note[1:]}." if note else None]
    found += [] if remedies is None else [remedies.attrs.get(k) for k in _REMEDY_WORDS]
    if known is not None and known.attrs.get("method") == "exact" and known.attrs.get("note"):
        found.append(f"No exact variance at every n: {known.attrs['note']}.")
    return " ".join(str(sentence) for sentence in found if sentence)


def basis_name(basis: str | None) -> str:
    """Return the name of a basis for sentences and tables. Fourier and Walsh are capitalized."""
    return {None: "Fourier", "fourier": "Fourier", "walsh": "Walsh"}.get(basis, str(basis))


def _is_predicted(row: SummaryRow) -> bool:
    """Whether the ratio of predicted to measured variance comes from `predict`.

    If not, the predicted variance is a sum of variance terms over frequencies.
    """
    return row.ratio is not None and row.ratio != row.captured


def _verdict(row: SummaryRow) -> str:
    """Compare the rate with that of random sampling in a few words; empty without a rate."""
    if row.rate is None or row.rate_low is None or row.rate_high is None:
        return "" if row.variance != 0 else "no variance"
    if not is_resolved(row.rate_low, row.rate_high):
        return f"rate {UNRESOLVED}"
    half = 0.5 * _RATE_MARGIN * (row.rate_high - row.rate_low)
    if row.rate + half < -1.0:
        return "faster than random sampling"
    if row.rate - half > -1.0:
        return "slower than random sampling"
    return "random sampling's rate" if half < _SURE else "rate undecided"


def _rate_sentence(row: SummaryRow) -> str:
    if row.n is None:
        return ""
    if row.rate is None:
        if row.variance == 0:
            return f"The variance at n = {row.n} is zero, so there is no rate to fit."
        return "There is no rate: a fit needs two counts with a variance above rounding noise."
    if row.rate_low is None or row.rate_high is None:
        return f"The variance falls as n to the power {number(row.rate)}; its interval is unknown."
    if not is_resolved(row.rate_low, row.rate_high):
        return f"The rate is {UNRESOLVED}."
    fitted = rate(row.rate, row.rate_low, row.rate_high)
    if row.fit_first_n is not None:
        fitted += f", fitted over n = {row.fit_first_n} … {row.n},"
    verdict = _verdict(row)
    if not verdict.endswith("sampling"):
        return f"The rate {fitted} is within three standard errors of random sampling's −1."
    return f"The rate {fitted} is {verdict}'s −1."


def _term_sentences(row: SummaryRow, terms: xr.Dataset) -> Iterator[str]:
    infinite = [t for t in ("dc", "power") if math.isinf(float(terms[f"{t}_term"]))]
    if infinite:
        verb, noun = ("are", "terms") if len(infinite) > 1 else ("is", "term")
        yield f"The {' and '.join(infinite)} {noun} {verb} infinite because ∫1/p diverges."
        yield f"The measured variance is {number(row.measured)}."
        yield 'Use space="primary", where the terms are finite.'
        return
    if row.measured == 0:
        yield "The measured variance is zero, so no term needs an explanation."
        return
    if row.captured is None:
        yield "The measured variance is rounding noise, so no term needs an explanation."
        return
    if row.dc is None or row.power is None or row.predicted is None or row.measured is None:
        return
    uniform = row.dc <= NEGLIGIBLE * row.power or terms.attrs.get("space") == "primary"
    # Mention the dc term if it makes most of the sum of the dc term and the power term
    if not uniform and row.dc > _DOMINANT * (row.dc + row.power):
        yield (
            f"Without the cross term, {percent(row.dc / (row.dc + row.power))} of the variance is "
            "the dc term: noise of the weights 1/p, which does not depend on the shape of f."
        )
    spec = str(terms.attrs.get("sampler_spec", row.sampler))
    shifted = re.search(r"(\| shift|^random)$", spec) is not None
    yield _cross_sentence(row, row.dc + row.power, uniform, shifted)
    yield _captured_sentence(row, terms)


def _cross_sentence(row: SummaryRow, diagonal: float, uniform: bool, shifted: bool) -> str:
    """Describe how the cross term changes dc + power, and how a random shift would affect it."""
    if row.cross is None or row.cross_low is None or row.cross_high is None or diagonal <= 0:
        return ""
    if row.cross_low <= 0 <= row.cross_high:
        beside = "power term" if uniform else "dc and power terms"
        return (
            "The cross term does not differ significantly from zero "
            f"({beside}: {number(diagonal)})."
        )
    fourier, removes = row.basis in (None, "fourier"), row.cross < 0
    what = "the power term" if uniform else "the sum of dc and power terms"
    if not fourier:
        what = f"the diagonal of the {basis_name(row.basis)} basis"
    share = _cross_share(row)
    text = f"The cross term removes {share} of {what}"
    if not removes:
        text = f"The cross term adds {share} to {what}"
    if fourier and uniform and shifted:
        text += ", by chance: its mean is zero for randomly shifted points"
    elif fourier and removes:
        text += ": the correlation of frequencies suits the integrand, as with " + (
            "strata aligned to it; a random shift would lose this gain"
            if uniform
            else "a density that follows it"
        )
    elif fourier and uniform:
        text += "; a random shift of unbiased points would avoid this"
    return f"{text}."


def _captured_sentence(row: SummaryRow, terms: xr.Dataset) -> str:
    half_width, found = terms.sizes.get("half_width", 0) - 1, _agreement(row, terms)
    if row.captured is None or not found:
        return ""
    if found == "less":
        return (
            f"The spectrum up to half width {half_width} accounts for only {percent(row.captured)} "
            "of the measured variance; the rest is at higher frequencies."
        )
    if found == "more":
        return (
            f"The spectrum up to half width {half_width} predicts {number(row.captured)} times the "
            "measured variance: the sum over frequencies has not converged."
        )
    if found == "agrees":
        # The sentence about the result of `predict` already compares prediction and measurement
        if _is_predicted(row):
            return ""
        share = f"{row.captured:.0%}".replace("%", " %")
        return f"Prediction and measurement agree ({share})."
    return (
        f"The spectrum up to half width {half_width} predicts {percent(row.captured)} of the "
        "measured variance; the 95 % interval of this share contains 100 %."
    )


def _agreement(row: SummaryRow, terms: xr.Dataset) -> str:
    """Compare prediction and measurement: ``agrees``, ``less``, ``more``, ``open`` or empty.

    ``agrees`` means that prediction and measurement are close.
    ``less`` and ``more`` mean a prediction that is significantly too small or too large:
    prediction and measurement are not close, and the interval of their ratio excludes 1.
    ``open`` means that the interval decides nothing; the result is empty if an interval is unknown.
    """
    low, high = row.captured_low, row.captured_high
    if low is None or high is None:
        if "predicted_variance_ci" not in terms or not (row.measured_low and row.measured_high):
            return ""
        ends = (float(end) for end in terms["predicted_variance_ci"].values)
        low, high = (
            end / m for end, m in zip(ends, (row.measured_high, row.measured_low), strict=True)
        )
    if row.captured is None or not (math.isfinite(low) and math.isfinite(high)):
        return ""
    if abs(row.captured - 1.0) <= _CLOSE:
        return "agrees"
    return "less" if high < 1.0 else "more" if low > 1.0 else "open"


def _cross_share(row: SummaryRow) -> str:
    return percent(abs(row.cross or 0.0) / ((row.dc or 0.0) + (row.power or 0.0) or 1.0))


def _median_frequency(row: SummaryRow, terms: xr.Dataset) -> float | None:
    """Return the median |m|: half of the power term comes from lower frequencies.

    The result is None if the functions of the basis have no frequency |m|.
    """
    scale = {"fourier": 1.0, "cosine": 0.5}.get(row.basis or "fourier")
    if scale is None or "power_contribution" not in terms:
        return None
    power = terms["power_contribution"]
    if "technique" in power.dims:
        power = power.sum("technique")
    axes = [power[dim].values.astype(float) for dim in power.dims if dim in power.coords]
    if len(axes) != power.ndim:
        return None
    length = np.sqrt(sum(m**2 for m in np.meshgrid(*axes, indexing="ij")))
    values = np.where(length > 0, np.nan_to_num(power.values), 0.0)
    order = np.argsort(length, axis=None)
    total = np.cumsum(values.ravel()[order])
    if not total[-1] > 0:
        return None
    return scale * float(length.ravel()[order][np.searchsorted(total, 0.5 * total[-1])])
