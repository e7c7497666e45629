"""Growth of the third term's matrix with the number of dims, and maps and bands in its place."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from mcspectra.report.axes import log_axis
from mcspectra.report.figures.maps import band_covariances, contributions
from mcspectra.report.formatting import number
from mcspectra.report.gallery import Picture
from mcspectra.report.reproduction._dimension_terms import (
    RUNS,
    SMALL,
    bell_terms,
    components,
    entries,
    labelled_subsets,
    main_share,
    run_terms,
    subsets,
    with_matrix,
)
from mcspectra.report.reproduction.base import GALLERY_FINDINGS, Exhibit, Finding, identity
from mcspectra.report.style import ACCENT, PALETTE, WIDE, legend_below, new_figure, quiet

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["exhibit"]

_SAMPLERS = ("random", "jittered", "latin-hypercube")
_DIMS = (1, 2, 3, 4, 5, 6)
_HALF_WIDTHS = (8, 64, 256)
_BYTES = 16  # of a complex number

Terms: TypeAlias = "dict[str, xr.Dataset]"


def exhibit(*, quick: bool, seed: int) -> Exhibit:
    """Compare maps and bands with the matrix where it can be had, and use them where it cannot."""
    realizations = 200 if quick else 4000
    whole = {d: with_matrix(d, realizations, seed) for d in SMALL}
    runs = {d: run_terms("jittered", d, realizations, seed) for d in RUNS}
    bands = {name: run_terms(name, 3, 2 * realizations, seed) for name in _SAMPLERS}
    findings = (
        _growth(whole),
        _refused(),
        *(_map_is_row_sums(d, data) for d, data in whole.items()),
        *(_bands_are_blocks(d, data) for d, data in whole.items()),
        *(_map_sums(d, data) for d, data in runs.items()),
        _map_holds_the_third(runs),
        _anova(bands["random"]),
        _main_effects(bands),
    )
    return Exhibit(
        name="dimensionality",
        title="The third term grows fast with the number of dims; maps of it do not",
        slide="Third Term: Dimensionality grows fast. For one-dimensional problem [a matrix]. Difficult to gain insights "
        "in 2D (and beyond) due to high-dimensional nature of the third term.",
        formula=r"c_m = \mathrm{Re} \, \overline{f_m} \, \mathrm{Cov}(S_m, I_N), \qquad \sum_m c_m = "
        r"\mathrm{Var}(I_N)",
        caption=_caption(bands),
        pictures=(_sizes(), _map(seed, quick=quick), _bands(bands)),
        findings=findings,
    )


def _caption(bands: Terms) -> str:
    two, three = (entries(d, 64) for d in (2, 3))
    shares = ", ".join(f"{number(main_share(data))} ({name})" for name, data in bands.items())
    return (
        f"At |m| ≤ 64 the matrix has {number(entries(1, 64))} entries in one dim, {number(two)} in two "
        f"({number(two * _BYTES / 2**30)} GiB), {number(three)} in three. Its row sums, one number for each frequency, "
        "need no matrix: the contribution map sums to the variance and shows where correlation gives and takes; "
        "covariances of bands show it in any number of dims. In three dims the functions of one coordinate have, of "
        f"the variance of 64 points on a Gaussian bell, the shares {shares}."
    )


def _growth(whole: dict[int, xr.Dataset]) -> Finding:
    wrong = [d for d, x in whole.items() if x["cross_matrix"].size != entries(d, SMALL[d][1])]
    ratio = entries(2, 64) / entries(1, 64)
    return Finding(
        statement="The third term's matrix has (2K + 1)^(2d) entries: from one to two dims at K = 64 it grows by the "
        "factor (2K + 1)².",
        expected="129² = 16641",
        measured=ratio,
        interval=None,
        agrees=not wrong and ratio == 129**2,
        note="The formula is held against the sizes of matrices of 49 and 225 frequencies, in one and two dims.",
    )


def _refused() -> Finding:
    """Before any work is done."""
    from mcspectra.core.errors import ParameterError

    answer = "a matrix"
    try:
        bell_terms("jittered", 2, (64, 64), 2, 0, matrix=True)
    except ParameterError as error:
        answer = str(error)
    return Finding(
        statement="In two dims at |m| ≤ 64 the matrix is out of reach, and refused.",
        expected="a refusal",
        measured=answer,
        interval=None,
        agrees=answer != "a matrix",
    )


def _map_is_row_sums(dims: int, data: xr.Dataset) -> Finding:
    rows = data["cross_matrix"].values.sum(axis=1).real
    values = data["contribution"].values.ravel()
    return identity(
        f"The contribution map is the matrix summed over its rows, {_dims(dims)}: largest difference over the largest "
        "value.",
        error=float(np.abs(rows - values).max() / np.abs(values).max()),
        at_most=1e-10,
    )


def _dims(dims: int) -> str:
    return {1: "one dim", 2: "two dims", 3: "three dims", 4: "four dims"}[dims]


def _bands_are_blocks(dims: int, data: xr.Dataset) -> Finding:
    """Sets of entries are compared: the order of bands is that of their labels, not of the numbers."""
    of = subsets(dims, SMALL[dims][1])
    matrix = data["cross_matrix"].values
    blocks = [matrix[np.ix_(of == a, of == b)].sum().real for a in set(of) for b in set(of)]
    found = np.sort(data["band_covariance"].values.ravel())
    return identity(
        f"Covariances of ANOVA bands are sums over blocks of the matrix, {_dims(dims)}: largest difference over the "
        "largest value.",
        error=float(np.abs(np.sort(blocks) - found).max() / np.abs(found).max()),
        at_most=1e-10,
    )


def _map_sums(dims: int, data: xr.Dataset) -> Finding:
    total = float(data["predicted_variance"])
    bands = float(data["band_covariance"].sum())
    size = data["contribution"].size
    error = max(abs(float(data["contribution"].sum()) - total), abs(bands - total)) / total
    return identity(
        f"Map and bands sum to the variance without a matrix, {_dims(dims)}, {size} frequencies: larger relative "
        "difference.",
        error=error,
        at_most=1e-10,
        note=f"The matrix would have {number(size**2)} entries.",
    )


def _map_holds_the_third(runs: dict[int, xr.Dataset]) -> Finding:
    errors = []
    for data in runs.values():
        third = float((data["contribution"] - data["power_contribution"]).sum())
        errors.append(abs(third - float(data["cross_term"])) / float(data["power_term"]))
    return identity(
        "What the map has beyond the power |f_m|² C_mm sums to the third term, in one to four dims: largest "
        "difference over the second term.",
        error=max(errors),
        at_most=1e-10,
    )


def _anova(data: xr.Dataset) -> Finding:
    """Random points: every band's variance is its ANOVA component over N."""
    n, half_width = RUNS[3]
    known = components(3, half_width)
    order = labelled_subsets(data)
    kept = [k for k, subset in enumerate(order) if subset]
    found, se = (
        np.diag(data[name].values)[kept] for name in ("band_covariance", "band_covariance_se")
    )
    expected = np.array([known[order[k]] / n for k in kept])
    distance = float(np.max(np.abs(found - expected) / se))
    limit = _student_limit(int(data.attrs["batches"]) - 1, len(kept))
    return Finding(
        statement=f"In three dims, of random points the variance of each of {len(kept)} ANOVA bands is the ANOVA "
        "component of f over N: largest distance in standard errors.",
        expected=f"≤ {limit:.1f}",
        measured=distance,
        interval=None,
        agrees=distance <= limit,
        note="The limit is that of as many Student variables, of the batches, at the gallery's level.",
    )


def _student_limit(degrees: int, count: int) -> float:
    from scipy.special import stdtrit

    level = 0.95 ** (1 / (GALLERY_FINDINGS * count))
    return float(stdtrit(degrees, (1 + level) / 2))


def _main_effects(bands: Terms) -> Finding:
    """Stein (1987): a Latin hypercube integrates additive functions with o(1/N)."""
    share = {name: main_share(data) for name, data in bands.items()}
    return Finding(
        statement="The bands show what a sampler is for: a Latin hypercube takes away the functions of one coordinate, "
        "whose share of the variance is less than a tenth of what random points leave of it.",
        expected=f"< {number(share['random'] / 10)}",
        measured=share["latin-hypercube"],
        interval=None,
        agrees=abs(share["latin-hypercube"]) < share["random"] / 10,
        note="Stein (1987).",
    )


def _sizes() -> Picture:
    figure = new_figure(WIDE, 3.4)
    axes = figure.subplots()
    quiet(axes, grid=True)
    for half_width, color in zip(_HALF_WIDTHS, PALETTE, strict=False):
        matrix = [entries(d, half_width) for d in _DIMS]
        axes.plot(_DIMS, matrix, "o-", ms=4, color=color, lw=1.4, label=f"matrix, K = {half_width}")
        size = np.sqrt(np.array(matrix, float))
        axes.plot(_DIMS, size, "o--", ms=4, color=color, lw=1.4, label=f"map, K = {half_width}")
    memory = 2**36 / _BYTES
    axes.axhline(memory, color=ACCENT, lw=1)
    axes.text(0.85, memory * 3, "64 GiB", color=ACCENT, fontsize=8)
    log_axis(axes, "y", 10.0, float(entries(6, 256)))
    axes.set(xlabel="number of dims d", ylabel="numbers to store", xlim=(0.8, 6.2), xticks=_DIMS)
    legend_below(figure, axes, columns=3)
    return Picture(
        kind="dimensionality",
        caption="Entries of the third term's matrix, (2K + 1)^(2d), and of a contribution map, (2K + 1)^d, for "
        "frequencies |m| ≤ K. The orange line is what fits into 64 GiB.",
        alt="Logarithmic plot over 1 to 6 dims. Lines of the matrix rise twice as steeply as those of the maps; for K "
        "= 64 the matrix is beyond 64 GiB from three dims on, the map from five on.",
        figure=figure,
    )


def _map(seed: int, *, quick: bool) -> Picture:
    half_width = 24
    names = ("jittered", "jittered | shift")
    data = {
        name: bell_terms(name, 2, (64, half_width), 600 if quick else 20_000, seed)
        for name in names
    }
    return Picture(
        kind="contribution-map",
        caption=f"Contribution maps in two dims, 64 points on a Gaussian bell that the border cuts: {2 * half_width + 1}² "
        "numbers instead of a matrix of 5.8 million. Jittered points as they are gain along the axes, where f has its "
        "jumps at the border.",
        alt="Two images over the frequencies with a cross along the axes around a dark spot. For jittered points the "
        "arms of the cross have both signs; after the shift they are positive, but for noise.",
        figure=contributions(data),
    )


def _bands(bands: Terms) -> Picture:
    return Picture(
        kind="band-map",
        caption="Covariances of ANOVA bands in three dims, 64 points: by the coordinates along which the frequencies of "
        "a band are not 0; below, their shares of the variance.",
        alt="For random, jittered and Latin hypercube points a matrix of 8 × 8 bands, and bars of shares. Those of one "
        "coordinate are the largest for random points and vanish for the Latin hypercube.",
        figure=band_covariances(bands),
    )
