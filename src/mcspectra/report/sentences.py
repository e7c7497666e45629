"""Plain sentences about a result, from its numbers only, and only what their intervals support."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

from mcspectra.report.formatting import NEGLIGIBLE, number, percent, rate
from mcspectra.studies import SummaryRow

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["explain", "further_sentences"]

_DOMINANT = 0.9
_CLOSE = 0.1  # prediction and measurement are said to agree
_RATE_MARGIN = 1.5
_REMEDY_WORDS = ("diagnosis", "recommendation")


def explain(row: SummaryRow, terms: xr.Dataset | None = None) -> str:
    """Say in a few plain sentences what the numbers of one estimator and sampler mean.

    Parameters
    ----------
    row
        The summary of the pair.
    terms
        Its `variance_terms` (one channel), if there are any.

    Returns
    -------
    str
        Sentences about the rate, the terms and the captured share; empty if nothing is known.

    Notes
    -----
    A share is called so only where the 95 % intervals exclude the contrary. Those of the prediction
    and the measurement are treated as independent, although both come from the same realisations:
    that is cautious.
    """
    sentences = [_rate_sentence(row)]
    if terms is not None:
        sentences += _term_sentences(row, terms)
    return " ".join(sentence for sentence in sentences if sentence)


def further_sentences(analyses: Mapping[str, xr.Dataset]) -> str:
    """Say what other analyses of a pair found in words: the best remedy, why nothing is exact."""
    remedies, exact = analyses.get("remedies"), analyses.get("exact")
    found = [] if remedies is None else [remedies.attrs.get(k) for k in _REMEDY_WORDS]
    if exact is not None and exact.attrs.get("note"):
        found.append(f"No exact variance at every n: {exact.attrs['note']}")
    return " ".join(str(sentence) for sentence in found if sentence)


def _rate_sentence(row: SummaryRow) -> str:
    if row.n is None:
        return ""
    if row.rate is None:
        if row.variance == 0:
            return f"The variance at n = {row.n} is zero: there is no rate to fit."
        return "There is no rate: it takes two counts with a variance above rounding noise."
    if row.rate_low is None or row.rate_high is None:
        return f"The variance falls like n to the {number(row.rate)}, interval unknown."
    fitted = rate(row.rate, row.rate_low, row.rate_high)
    if row.fit_first_n is not None:
        fitted += f", fitted over n = {row.fit_first_n} … {row.n},"
    # A page makes dozens of such statements: ask for 3 σ, half as much again as the 95 % interval.
    half = 0.5 * _RATE_MARGIN * (row.rate_high - row.rate_low)
    if row.rate + half < -1.0:
        return f"The rate {fitted} is faster than random sampling's −1."
    if row.rate - half > -1.0:
        return f"The rate {fitted} is slower than random sampling's −1."
    return f"The rate {fitted} cannot be told from random sampling's −1."


def _term_sentences(row: SummaryRow, terms: xr.Dataset) -> list[str]:
    infinite = [t for t in ("dc", "power") if math.isinf(float(terms[f"{t}_term"]))]
    if infinite:
        verb, noun = ("are", "terms") if len(infinite) > 1 else ("is", "term")
        return [
            f"The {' and '.join(infinite)} {noun} {verb} infinite because ∫1/p diverges.",
            f"The measured variance is {number(row.measured)}.",
            "The primary-space view has finite terms.",
        ]
    if row.measured == 0:
        return ["The measured variance is zero: there is nothing to explain."]
    if row.captured is None:
        return ["The measured variance is rounding noise: there is nothing to explain."]
    if row.dc is None or row.power is None or row.predicted is None or row.measured is None:
        return []
    low, high = (float(end) for end in terms["predicted_variance_ci"].values)
    uniform = row.dc <= NEGLIGIBLE * row.power or terms.attrs.get("space") == "primary"
    return [
        _dc_sentence(row.dc, row.power, uniform),
        _cross_sentence(row, row.dc + row.power, (low, high), uniform)
        if row.basis in (None, "fourier")
        else _other_cross_sentence(row, row.dc + row.power, (low, high)),
        _captured_sentence(row, (low, high), terms.sizes.get("half_width", 0) - 1),
    ]


def _dc_sentence(dc: float, power: float, uniform: bool) -> str:
    """Name the dc term where it dominates the diagonal by far more than sampling error."""
    if uniform or dc <= _DOMINANT * (dc + power):
        return ""
    return (
        f"Before correlation, {percent(dc / (dc + power))} of the variance is the dc term: noise of "
        "the weights 1/p, which f does not shape."
    )


def _cross_sentence(
    row: SummaryRow, diagonal: float, interval: tuple[float, float], uniform: bool
) -> str:
    """Say what the cross term gives or takes of dc + power, and what of that a shift would change."""
    predicted = row.predicted or 0.0
    if diagonal <= 0 or predicted <= 0 or not all(map(math.isfinite, interval)):
        return ""
    low, high = _diagonal_limits(predicted, interval)
    what = "the power term predicts" if uniform else "the dc and power terms predict together"
    change = predicted / diagonal - 1.0
    if high < diagonal:
        fate = "; a random shift would lose that" if uniform else ""
        cause = "strata aligned to it" if uniform else "a density that follows it"
        return (
            f"The cross term removes {percent(-change)} of what {what}: frequencies are correlated "
            f"in the integrand's favour, as with {cause}{fate}."
        )
    if low > diagonal:
        cure = "; for unbiased points a random shift would avoid that" if uniform else ""
        return f"The cross term adds {percent(change)} to what {what}{cure}."
    return f"The cross term cannot be told from zero beside what {what}."


def _other_cross_sentence(row: SummaryRow, diagonal: float, interval: tuple[float, float]) -> str:
    """Say the same in another basis, on which a shift acts in other ways."""
    predicted = row.predicted or 0.0
    if diagonal <= 0 or predicted <= 0 or not all(map(math.isfinite, interval)):
        return ""
    low, high = _diagonal_limits(predicted, interval)
    what = f"what the diagonal of the {row.basis} basis predicts"
    change = predicted / diagonal - 1.0
    if high < diagonal:
        return f"The cross term removes {percent(-change)} of {what}."
    if low > diagonal:
        return f"The cross term adds {percent(change)} to {what}."
    return f"The cross term cannot be told from zero beside {what}."


def _diagonal_limits(predicted: float, interval: tuple[float, float]) -> tuple[float, float]:
    """Limits between which dc + power may equal the prediction.

    The sum of the diagonal is uncertain as well; twice the relative interval of the prediction
    covers both.
    """
    return interval[0] ** 2 / predicted, interval[1] ** 2 / predicted


def _captured_sentence(row: SummaryRow, interval: tuple[float, float], half_width: int) -> str:
    captured, low, high = row.captured, row.measured_low, row.measured_high
    if captured is None or low is None or high is None or not all(map(math.isfinite, interval)):
        return ""
    if interval[1] < low:
        return (
            f"Only {percent(captured)} of the measured variance is captured at half width "
            f"{half_width}: the rest lies at higher frequencies."
        )
    if interval[0] > high:
        return (
            f"Truncated at half width {half_width}, the spectrum predicts {number(captured)} times "
            "the measured variance: the sum over frequencies has not converged."
        )
    if abs(captured - 1.0) <= _CLOSE:
        return (
            f"Prediction and measurement agree ({captured:.0%}), within their intervals.".replace(
                "%", " %"
            )
        )
    return (
        f"At half width {half_width} the spectrum predicts {percent(captured)} of the measured "
        "variance."
    )
