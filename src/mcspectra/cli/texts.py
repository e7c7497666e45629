"""Text of the result of an analysis, and additional data for --json.

`VIEWS` contains the analyses that have their own tables.
For all other analyses, the function `table_of_anything` makes a table.
The table lists scalars with their meanings and intervals; further tables have one dim each.
"""

from __future__ import annotations

import itertools
import json
import math
import textwrap
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from mcspectra.cli.common import VerbOutput, page_table, text_table
from mcspectra.core.errors import NoClosedForm
from mcspectra.core.fits import UNRESOLVED, is_resolved
from mcspectra.plots.groups import along, method_of
from mcspectra.plots.variance import BELOW_ROUNDING, below_rounding

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["VIEWS", "View", "data_of", "remedies_table", "table_of_anything"]

_WIDTH = 100
_CERTAIN = 2e-6  # below this relative width, an interval is not printed
_ROUNDING = 1e-14  # below this share of the variance, a sum is a rounding error
_MANY = 10_000  # maximum number of values per variable in --json


View = Callable[["xr.Dataset"], VerbOutput]
"""Function that turns a result into a text, and into JSON entries in addition to `data_of`."""

VIEWS: dict[str, dict[str, View]] = {}
"""For each analysis, the views by name. --show selects a view; the first view is the default."""


def _view(analysis: str, name: str = "") -> Callable[[View], View]:
    """Register a view of the result of an analysis."""

    def register(shows: View) -> View:
        VIEWS.setdefault(analysis, {})[name] = shows
        return shows

    return register


def _shown(*parts: str, **data: Any) -> VerbOutput:
    """Join those parts of a text that are not empty, each on its own lines."""
    return VerbOutput("\n".join(filter(None, parts)), data)


def _columns(result: xr.Dataset, *names: str) -> Iterator[tuple[Any, ...]]:
    """Iterate over several variables of equal shape at once, entry by entry."""
    return zip(*(result[name].values.ravel() for name in names), strict=True)


def data_of(result: xr.Dataset) -> dict[str, Any]:
    """Return all attributes, and those variables that are small enough to read."""
    small = {str(name): v.values for name, v in result.variables.items() if v.size <= _MANY}
    return {**{str(key): value for key, value in result.attrs.items()}, **small}


def table_of_anything(result: xr.Dataset) -> VerbOutput:
    """Prints scalars with their meanings and 95 % intervals, then one table per dim."""
    partners = {f"{name}{end}" for name in result.data_vars for end in ("_ci", "_se")}
    shown = {str(k): v for k, v in result.data_vars.items() if k not in partners}
    rows, columns, large = [], dict[str, list[str]](), []
    for name, values in shown.items():
        if values.ndim == 0:
            meaning = str(values.attrs.get("long_name", name.replace("_", " ")))
            unit = str(values.attrs.get("units", ""))
            unit = "" if unit == "1" else unit
            rows.append([meaning, unit, _value(result, name, ()), _error(result, name, ())])
        elif values.ndim == 1:
            columns.setdefault(str(values.dims[0]), []).append(name)
        else:
            large.append(f"{name}: over {', '.join(map(str, values.dims))}; --out writes it")
    parts = [_title(result), text_table(["", "unit", "value", "95 %"], rows) if rows else ""]
    for dim, names in columns.items():
        header = [dim, "", *(h for name in names for h in (name.replace("_", " "), "95 %"))]
        places = result[dim].values if dim in result.coords else np.arange(result.sizes[dim])
        cells = [
            [_cell(place), "", *(c for name in names for c in
             (_value(result, name, (k,)), _error(result, name, (k,))))]
            for k, place in enumerate(places)
        ]  # fmt: skip
        kept = [i for i in range(len(header)) if i < 2 or any(row[i] for row in cells)]
        parts.append(text_table([header[i] for i in kept], [[r[i] for i in kept] for r in cells]))
    return _shown(*parts, *large, _note(result))


def _title(result: xr.Dataset) -> str:
    """Return a title with n and the specs of the estimator and the sampler."""
    known = result.attrs
    names = [str(known[key]) for key in ("estimator", "sampler") if key in known]
    counts = f",  n = {known['n']}" if "n" in known else ""
    return "  with  ".join(names) + counts


def _note(result: xr.Dataset) -> str:
    return str(result.attrs.get("note", ""))


def _number(value: float, digits: int = 5, missing: str = "–") -> str:
    """Format a number with `digits` digits. Infinity becomes a word."""
    if math.isinf(value):
        return "infinite"
    return missing if math.isnan(value) else f"{value:.{digits}g}"


def _cell(value: Any) -> str:
    return _number(float(value), 6) if isinstance(value, float | np.floating) else str(value)


def _value(result: xr.Dataset, name: str, place: tuple[int, ...]) -> str:
    """Format a rate. A rate that is not resolved becomes ``unresolved``."""
    if name.endswith("rate") and f"{name}_ci" in result:
        low, high = result[f"{name}_ci"].values[place]
        if high - low > 0 and not is_resolved(low, high):
            return "unresolved"
    return _cell(result[name].values[place])


def _interval(ends: Any, digits: int = 4) -> str:
    """Format an interval, whose upper end may be infinite; empty if an end is unknown."""
    low, high = ends
    known = math.isfinite(low) and not math.isnan(high)
    return f"{low:.{digits}g} … {_number(high, digits)}" if known else ""


def _error(result: xr.Dataset, name: str, place: tuple[int, ...]) -> str:
    """Format the interval of a number, or else ± two standard errors; empty if both are missing."""
    if f"{name}_ci" in result:
        return _interval(result[f"{name}_ci"].values[place])
    error = float(result[f"{name}_se"].values[place]) if f"{name}_se" in result else math.nan
    return "" if math.isnan(error) else f"± {_number(1.96 * error, 2)}"


@_view("convergence")
def convergence(result: xr.Dataset) -> VerbOutput:
    """Prints the variance at each n, the rate ± half its interval, and how well a line fits."""
    header = ["sampler", "", *(f"n = {n}" for n in result["n"].values), "rate", "±"]
    rows, curves, notes = [], [], list[str]()
    for sampler, picked in along(result, "sampler"):
        channels = picked.sizes.get("channel", 0)
        for channel in range(max(channels, 1)):
            curve = picked.isel(channel=channel) if channels else picked
            label = f"[{channel}]" if channels > 1 else ""
            fit = ["–"] * 4
            if np.isfinite(rate := float(curve["rate"])):
                low, high = curve["rate_ci"].values
                fit = [
                    f"{rate:+.3f}",
                    f"{(high - low) / 2:.3f}",
                    f"{float(curve['fit_first_n']):.0f}",
                    _number(float(curve["fit_chi2"]), 3),
                ]
                if not is_resolved(low, high):
                    half = _number((high - low) / 2, 3)
                    fit[:2] = ["unresolved", half]
                    notes.append(
                        f"{sampler}{label}: the fitted rate, {rate:+.2f} ± {half}, is {UNRESOLVED}"
                    )
            elif below_rounding(curve):
                fit[0] = BELOW_ROUNDING
            # If the interval has no upper end, print the lower end next to the number
            variances = [
                f"{v:.4g}" + (f" (≥ {low:.4g})" if math.isinf(high) else "")
                for v, (low, high) in zip(
                    curve["variance"].values, curve["variance_ci"].values, strict=True
                )
            ]
            rows.append([sampler, label, *variances, *fit])
        missed = result["n"].values[picked["reached"].values == 0] if "reached" in result else []
        if len(missed):
            goal, most = result.attrs["relative_error"], result.attrs["realizations"]
            notes.append(
                f"{sampler}: the relative error {goal:g} was not reached with {most} realizations "
                f"at n = {', '.join(map(str, missed))}"
            )
        values = {str(name): variable.values for name, variable in picked.data_vars.items()}
        curves.append({"sampler": sampler, "n": result["n"].values, **values})
    table = text_table([*header, "fit from n", "χ²/dof"], rows)
    title = f"variance of {result.attrs['estimator']}"
    return _shown(title, table, *notes, _note(result), curves=curves)


@_view("terms")
def terms(result: xr.Dataset) -> VerbOutput:
    """Prints the terms of the variance, their sum, the measured variance, and the ratio of both.

    The command prints one table for each sampler.
    The energy share is the fraction of ∫f² at frequencies up to the half width.
    The tail term estimates the variance at higher frequencies as if the points were random.
    """
    known = result.attrs
    about = (
        f"coefficients: {known['coefficients']}; {known['realizations']} realizations; "
        f"{known['space']} space, {known['basis']} basis"
    )
    parts = []
    sums = ("predicted_variance", "measured_variance", "captured")
    for sampler, one in along(result, "sampler"):
        rows = []
        for name in ("dc_term", "power_term", "cross_term", *sums, "energy_share", "tail_term"):
            values = np.atleast_1d(one[name].values)
            shown = ", ".join(_number(v, 6, "undefined") for v in values)
            ends = np.atleast_2d(one[f"{name}_ci"].values)[0] if f"{name}_ci" in one else None
            interval = "" if ends is None else _interval(ends)
            rows.append([name.replace("_", " "), "", shown, interval])
        parts += [
            f"\n{sampler}" if "sampler" in result.dims else "",
            text_table(["", "", "value", "95 % interval"], rows),
        ]
    note = f"\n{_note(result)}" if "sampler" in result.dims and _note(result) else _note(result)
    labels = result["band"].attrs["labels"].split(", ")
    return _shown(_title(result), about, *parts, note, band_labels=labels)


@_view("spectrum", "power")
def power(result: xr.Dataset) -> VerbOutput:
    """Prints the radial mean of power times n, which is 1 for random points."""
    n, dims = result.attrs["n"], sum(str(d).startswith("m") for d in result["power"].dims)
    rows = [
        [f"{r:.4g}", f"{r / n ** (1 / dims):.3f}", f"{n * p:.5g}", _number(n * se)]
        for r, p, se in _columns(result, "radius", "radial_power", "radial_power_se")
    ]
    return _shown(text_table(["|m|", "|m|/n^(1/d)", "n·power", "std. error"], rows))


@_view("spectrum", "radial")
def radial(result: xr.Dataset) -> VerbOutput:
    """power by radius with errors and anisotropy"""
    from mcspectra.spectra.shapes import radial_statistics

    found, n = radial_statistics(result), result.attrs["n"]
    names = ("radius", "radial_power", "radial_power_se", "anisotropy_db", "anisotropy_noise_db")
    header = ["|m|", "", "n·power", "std. error", "anisotropy dB", "noise alone dB"]
    rows = [
        [f"{r:.4g}", "", *map(_number, (n * power, n * error, *anisotropy))]
        for r, power, error, *anisotropy in _columns(found, *names)
    ]
    return _shown(text_table(header, rows), **data_of(found))


@_view("spectrum", "slices")
def slices(result: xr.Dataset) -> VerbOutput:
    """power along the axes and the diagonals"""
    from mcspectra.spectra.shapes import slices

    found, n = slices(result), result.attrs["n"]
    labels = np.repeat(found["slice"].values, found.sizes["multiple"])
    columns = _columns(found, "slice_radius", "slice_power", "slice_power_se")
    rows = [
        [str(label), f"{r:.4g}", _number(n * power), _number(n * se)]
        for label, (r, power, se) in zip(labels, columns, strict=True)
    ]
    return _shown(text_table(["direction", "|m|", "n·power", "std. error"], rows), **data_of(found))


@_view("spectrum", "wedges")
def wedges(result: xr.Dataset) -> VerbOutput:
    """power by direction"""
    from mcspectra.spectra.shapes import wedge_means

    found, n = wedge_means(result), result.attrs["n"]
    rows = [
        [f"{angle:.4g}°", "", _number(n * power), _number(n * se)]
        for angle, power, se in _columns(found, "angle", "wedge_power", "wedge_power_se")
    ]
    return _shown(text_table(["direction", "", "n·power", "std. error"], rows), **data_of(found))


@_view("spectrum", "exponent")
def exponent(result: xr.Dataset) -> VerbOutput:
    """exponent b of power ∝ |m|^b at low frequencies"""
    from mcspectra.spectra.shapes import low_frequency_exponent

    found = low_frequency_exponent(result)
    known = found.attrs
    b, chi2 = (float(found[n]) for n in ("low_frequency_exponent", "exponent_fit_chi2"))
    if known.get("reason"):
        return _shown(f"no exponent: {known['reason']}", **data_of(found))
    where = "" if known["directions"] == "all" else f", directions {known['directions']}"
    text = (
        f"power ∝ |m|^b for |m| ≤ {known['up_to']:.4g} ({known['lengths']} lengths{where}): "
        f"b = {b:.4g}, 95 % interval {_interval(found['low_frequency_exponent_ci'].values)}, "
        f"χ² per degree of freedom {chi2:.3g}"
    )
    return _shown(text, **data_of(found))


@_view("pcf")
def pcf(result: xr.Dataset) -> VerbOutput:
    """Prints the distance r, r / n^(-1/d) (in mean spacings), g(r) and its standard error."""
    spacing = result.attrs["n"] ** (-1.0 / result.attrs["dims"])
    rows = [
        [f"{r:.5g}", f"{r / spacing:.3f}", f"{g:.5g}", _number(se, 2)]
        for r, g, se in _columns(result, "r", "pair_correlation", "pair_correlation_se")
    ]
    table = text_table(["r", "r·n^(1/d)", "g(r)", "std. error"], rows)
    return _shown(table, mean_spacing=spacing)


@_view("anova")
def anova(result: xr.Dataset) -> VerbOutput:
    """Prints the variance of each subset of axes, and of all larger subsets together.

    The text ends with the mean dimension and the effective dimensions.
    Shares and dimensions have 95 % intervals.
    The intervals may exceed the range from 0 to 1, or the number of axes.
    """
    lines = [_title(result)]
    labels, order = list(map(str, result["subset_label"].values)), result.attrs["order"]

    def part(values: Sequence[float], floor: float) -> list[str]:
        # Variance, standard error and share of a subset of axes, which are 0 below rounding level
        floors = (floor, floor, _ROUNDING)
        return [
            "0" if abs(value) < least else _number(value, missing="undefined")
            for value, least in zip(values, floors, strict=True)
        ]

    for channel in range(result.sizes.get("channel", 1)):
        one = result.isel(channel=channel) if "channel" in result.dims else result
        lines += [f"channel {channel}"] if "channel" in result.dims else []
        floor = _ROUNDING * float(one["variance"])
        columns = _columns(one, "anova_variance", "anova_variance_se", "anova_share")
        rows = [
            [
                u,
                "",
                *part(v, floor),
                _error(one, "anova_share", (k,)) if abs(v[2]) > _ROUNDING else "",
            ]
            for k, (u, v) in enumerate(zip(labels, columns, strict=True))
        ]
        larger = ("higher_order_variance", "higher_order_variance_se", "higher_order_share")
        rest = [float(one[name]) for name in larger]
        ends = _error(one, "higher_order_share", ()) if abs(rest[2]) > _ROUNDING else ""
        rows.append(["larger subsets", "", *part(rest, floor), ends])
        header = ["axes", "", "variance", "std. error", "share", "95 % interval"]
        lines.append(text_table(header, rows))
        varies = np.isfinite(float(one["mean_dimension"]))
        for name in ("variance", "mean_dimension", "effective_dimension_truncation",
                     "effective_dimension_superposition"):  # fmt: skip
            beyond = varies and name.endswith("superposition")
            missing = f"more than {order}" if beyond else "undefined"
            ends = _error(one, name, ())
            ends = f", 95 % interval {ends}" if ends else ""
            lines.append(f"{name.replace('_', ' ')}: {_number(float(one[name]), 6, missing)}{ends}")
    return _shown(*lines, _note(result), subset=labels)


@_view("profile")
def profiled(result: xr.Dataset) -> VerbOutput:
    """Prints advice, the causes of the noise with evidence, and error and rate of each sampler."""
    plain = {name: json.loads(result.attrs[name]) for name in ("causes", "best")}
    return VerbOutput(result.attrs["text"], plain)


@_view("plan")
def planned(result: xr.Dataset) -> VerbOutput:
    """Prints the smallest n for the error, and the predicted errors at other n."""
    if np.isnan(result["planned_n"]).all() and np.isnan(result["predicted_variance"]).all():
        raise NoClosedForm(f"{_note(result)[:1].upper()}{_note(result)[1:]}.")
    variances = [one["predicted_variance"] for _, one in along(result, "sampler")]
    columns = [np.sqrt(v.values.reshape(result.sizes["n"], -1).max(axis=1)) for v in variances]
    rows = [
        [str(n), "", *(_number(float(error), 5) for error in row)]
        for n, *row in zip(result["n"].values, *columns, strict=True)
        if np.isfinite(row).any()
    ]
    named = "sampler" in result.dims
    header = ["n", "", *(map(str, result["sampler"].values) if named else ["predicted RMSE"])]
    known = result.attrs
    goal = f"RMSE {known['target_error']:g}{' of the integral' if known['relative'] else ''}"
    return _shown(
        f"{goal} of {_title(result)}: {known['answer']}",
        "predicted RMSE" if named and rows else "",
        text_table(header, rows) if rows else "",
        "" if _note(result) in known["answer"] else _note(result),
    )


@_view("predict")
def prediction(result: xr.Dataset) -> VerbOutput:
    """Prints the predicted variance at each n with its interval, local rate and method."""
    if np.isnan(result["predicted_variance"]).all():
        raise NoClosedForm(f"{_note(result)[:1].upper()}{_note(result)[1:]}.")
    parts, several = [f"predicted variance of {_title(result)}"], "method" in result.dims
    names = ("predicted_variance", "local_rate", "energy_share")
    header = ["n", "", "variance", "95 %", "local rate", "share", "method"]
    for sampler, one in along(result, "sampler"):
        rows, reasons = [], []
        for n, (method, each) in itertools.product(range(one.sizes["n"]), along(one, "method")):
            at = each.isel(n=n)
            numbers = [at[name].values.reshape(-1) for name in names]
            ends = at["predicted_variance_ci"].values.reshape(-1, 2)
            if several and np.isnan(numbers[0]).all():
                reasons.append(f"{method}: {at['how'].item()}.")
                continue
            for channel, (value, slope, share) in enumerate(zip(*numbers, strict=True)):
                low, high = ends[channel]
                certain = high - low <= _CERTAIN * abs(value)
                cells = (
                    _number(float(value), 9 if certain else 4),
                    "" if certain else _interval((low, high)),
                    f"{slope:+.2f}".replace("-", "−") if np.isfinite(slope) else "–",
                    f"{share:.4f}" if np.isfinite(share) else "–",
                )
                label = f"[{channel}]" if len(ends) > 1 else ""
                rows.append([str(int(at["n"])), label, *cells, method_of(at, channel)])
        rates = "; ".join(
            f"rate: {rate:+.3f}"
            + (f", tends to {limit:+.3f}" if np.isfinite(limit) else "")
            + (f", bends at n = {bend:.3g}" if np.isfinite(bend) else "")
            for rate, limit, bend in _columns(one, "predicted_rate", "limit_rate", "bend_n")
            if np.isfinite(rate) and not several
        )
        parts += [
            f"\n{sampler}" if "sampler" in result.dims else "",
            text_table(header, rows),
            rates.replace("-", "−"),
            "no value from" if reasons else "",
            *(textwrap.fill(each, _WIDTH, initial_indent="  ", subsequent_indent="    ")
              for each in dict.fromkeys(reasons)),
        ]  # fmt: skip
    return _shown(*parts, _note(result))


@_view("remedies")
def remedies(result: xr.Dataset) -> VerbOutput:
    """Prints advice with its reasons, then the measured changes in the order of their variances."""
    known, listed = result.attrs, []
    for name in result["remedy"].values:
        one = result.sel(remedy=name)
        listed.append({str(key): v.values for key, v in one.variables.items()})
    title = f"{_title(result)},  {known['budget']} evaluations"
    said = [textwrap.fill(known[name], _WIDTH) for name in ("answer", "diagnosis")]
    left_out = [
        textwrap.fill(reason, _WIDTH, initial_indent="  ", subsequent_indent="    ")
        for reason in json.loads(known.get("not_tried", "[]"))
    ]
    left_out = ["not tried:", *left_out] if left_out else []
    best = json.loads(known["best"])
    parts = [*said, "", title, remedies_table(result), *left_out]
    return _shown("\n".join(parts), remedies=listed, best=best)


def remedies_table(result: xr.Dataset) -> str:
    """Return a table of the tried changes as text, with six columns of the table in reports."""
    from mcspectra.report.page import columns_of
    from mcspectra.report.tables import analysis_table

    made = analysis_table("remedies", {"": result})
    assert made is not None
    columns = ("Remedy", "Verdict", "Variance", "Ratio", "95 % interval", "Rate")
    return page_table(columns_of(made[1], columns), words=2)  # align remedy and verdict to the left


@_view("modes")
def modes(result: xr.Dataset) -> VerbOutput:
    """Prints the eigenvalues, their shares of the sum, and the variance of each mode."""
    trace, edge = float(result["band_trace"]), float(result["noise_edge"])
    # By rounding, eigenvalues that should be zero are about 1e-13 of the sum
    there = int(np.count_nonzero(result["eigenvalue"].values > 1e-13 * trace))
    if not there:
        return _shown(f"{_title(result)}\nno mode: the coefficients do not vary")
    ends = ("eigenvalue", "eigenvalue_se", "eigenvalue_share", "eigenvalue_residual")
    columns = list(_columns(result, *ends, "mode_contribution"))[:there]
    rows = [[str(k), "", *map(_number, values)] for k, values in enumerate(columns)]
    header = ["mode", "", "eigenvalue", "standard error", "share", "numerical residual ≤"]
    more = result.sizes["mode"] - there
    return _shown(
        _title(result),
        text_table([*header, "part of variance"], rows),
        f"{more} more at rounding level" if more else "",
        _note(result),
        f"largest eigenvalue of a flat spectrum with the same sum (noise edge): {edge:.6g}",
        f"sum of all eigenvalues: {trace:.6g}",
    )
