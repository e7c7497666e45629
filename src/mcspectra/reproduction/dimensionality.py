"""The third variance term is a sum over a matrix that grows quickly with the number of dims.

Contribution maps and ANOVA bands show the same term, and do not need the matrix.
"""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import xarray as xr

import mcspectra as mcs
from mcspectra.core.checks import Array
from mcspectra.plots.description import (
    Axis,
    BarChart,
    Dots,
    Heatmap,
    Line,
    Mark,
    Panel,
    Plot,
    ReferenceLine,
    Scale,
    TextMark,
)
from mcspectra.plots.kinds import describe
from mcspectra.plots.scales import log_axis, name_axis
from mcspectra.plots.style import INK, MARKERS, PALETTE
from mcspectra.plots.text import number
from mcspectra.reproduction.claims import (
    Claim,
    Exhibit,
    Measured,
    about,
    correction,
    largest_distance,
)
from mcspectra.reproduction.panels import in_columns, plot_of, term_panel

__all__ = ["exhibit"]

SAMPLERS = ("random", "jittered", "latin-hypercube")
BELL = "gaussian(center=0.35, width=0.25)"
# Number of points and half width for each number of dims, for matrices that fit in memory
SMALL = {1: (64, 24), 2: (64, 7)}
# Number of points and half width for each number of dims, for maps and bands
RUNS = {1: (64, 256), 2: (64, 48), 3: (64, 8), 4: (81, 4)}
_FEW = 100  # number of realizations for identities
_WORDS = {1: "one dim", 2: "two dims", 3: "three dims", 4: "four dims"}
DENSITY = "linear(slope=-1.2)"
_ORDERS = {
    "one coordinate": PALETTE[2],
    "two coordinates": PALETTE[5],
    "three coordinates": PALETTE[3],
}
_BYTES = 16  # bytes per complex number
_NEAR, _SHOWN = (
    3,
    1.0,
)  # half width of the map of low frequencies, and least share (%) with a number


def exhibit(*, quick: bool, seed: int) -> Exhibit:
    """Check maps and bands against a matrix in 1-D and 2-D; in more dims, show maps and bands."""
    # Sums over a matrix are compared for the same sets, so they agree for any number of sets
    whole = {d: bell_terms("jittered", d, SMALL[d], _FEW, seed, matrix=True) for d in SMALL}
    runs = {d: bell_terms("jittered", d, RUNS[d], _FEW, seed) for d in RUNS}
    realizations = 400 if quick else 2000
    bands = {name: bell_terms(name, 3, RUNS[3], realizations, seed) for name in SAMPLERS}
    one, two, three = (entries(d, 64) for d in (1, 2, 3))
    shares = ", ".join(f"{number(main_share(data))} ({name})" for name, data in bands.items())
    mapped = {
        name: bell_terms(name, 2, (64, 24), 600 if quick else 6000, seed)
        for name in ("jittered", "jittered | shift")
    }
    weighted = mcs.variance_terms(
        mcs.Estimator(mcs.integrand(BELL, 2), mcs.density(DENSITY, 2)),
        "jittered",
        64,
        half_width=24,
        realizations=400 if quick else 4000,
        rng=seed,
    )
    cases = {"jittered points": mapped["jittered"], "importance sampling": weighted}
    without = {
        name: (Measured.of(data, "predicted_variance") - Measured.of(data, "cross_term"))
        / Measured.of(data, "measured_variance")
        for name, data in cases.items()
    }

    maps = describe("contributions", mapped)

    # Check the formula for the size of a matrix, and the error message for too large a matrix
    wrong = [d for d, x in whole.items() if x["cross_matrix"].size != entries(d, SMALL[d][1])]
    times = entries(2, 64) / entries(1, 64)
    answer = "a matrix"
    try:
        bell_terms("jittered", 2, (64, 64), 2, 0, matrix=True)
    except mcs.McspectraError as refusal:
        answer = str(refusal)

    # Check that the contributions without their diagonal |f_m|² C_mm sum to the third term
    errors = [
        abs(float((data["contribution"] - data["power_contribution"]).sum() - data["cross_term"]))
        / float(data["power_term"])
        for data in runs.values()
    ]

    # For random points, the variance from a band of frequencies should be A/N,
    # where A is the ANOVA component of the axes of this band
    random, (n, half_width) = bands["random"], RUNS[3]
    known, order = components(3, half_width), labelled_subsets(random)
    kept = [k for k, subset in enumerate(order) if subset]
    found, se = (
        np.diag(random[name].values)[kept] for name in ("band_covariance", "band_covariance_se")
    )
    expected = np.array([known[order[k]] / n for k in kept])

    # A Latin hypercube integrates additive functions with the variance o(1/N) (Stein 1987)
    tenth = main_share(random) / 10
    return Exhibit(
        numbers={
            "one": number(one),
            "two": number(two),
            "gib": number(two * _BYTES / 2**30),
            "three": number(three),
            "shares": shares,
            "jittered": number(without["jittered points"].value, 2),
            "weighted": number(without["importance sampling"].value, 2),
            "nine": number(100.0 * float(_shares(weighted, 1).sum()), 2),
            "cut": number(1e4 * jittered_variance(24), 2),
            "whole": number(1e4 * float(mcs.exact_variance(BELL, "jittered", 64)), 2),
        },
        plots=(
            _sizes(),
            plot_of(
                "contribution-map",
                _terms_beside(weighted, "three terms and their sum"),
                _low_frequencies(weighted),
            ),
            plot_of("jittered-terms", _terms_beside(mapped["jittered"], "jittered points")),
            plot_of("order-shares", _orders_panel(bands)),
            replace(maps, kind="maps"),
            replace(in_columns(describe("bands", bands), first=1), kind="band-map"),
        ),
        claims=(
            Claim(
                "The third term's matrix has (2K + 1)^(2d) entries: from one to two dims at K = 64 "
                "it grows by the factor (2K + 1)².",
                times,
                holds=not wrong and times == 129**2,
                shown="129² = 16641",
                note="The formula is compared with matrices of 49 and 225 frequencies, in one and "
                "two dims.",
            ),
            Claim(
                "In two dims at |m| ≤ 64 the matrix is too large and gives an error.",
                answer,
                holds=answer != "a matrix",
                shown="an error message",
            ),
            *about(
                "contribution-map",
                *(_map_is_row_sums(d, data) for d, data in whole.items()),
                *(_bands_are_blocks(d, data) for d, data in whole.items()),
                *(_map_sums(d, data) for d, data in runs.items()),
                Claim(
                    "The map minus the power |f_m|² C_mm sums to the third term, in one to four "
                    "dims: "
                    "largest difference relative to the second term.",
                    max(errors),
                    at_most=1e-10,
                ),
                correction(
                    largest_distance(
                        f"For random points in three dims, the variance of each of {len(kept)} "
                        "ANOVA bands "
                        "is the ANOVA component of f divided by N",
                        found - expected,
                        se,
                        freedom=int(random.attrs["batches"]) - 1,
                    )
                ),
                correction(
                    Claim(
                        "Bands show the strength of a sampler: a Latin hypercube integrates "
                        "functions of "
                        "one coordinate well, so their share of the variance is less than a "
                        "tenth of the "
                        "share for random points.",
                        main_share(bands["latin-hypercube"]),
                        above=-tenth,
                        below=tenth,
                        shown=f"< {number(tenth)}",
                        note="Stein (1987).",
                    )
                ),
                *(
                    Claim(
                        f"Without the third term the prediction is too large, {name} in two dims: "
                        "first plus second term, divided by the measured variance.",
                        ratio,
                        above=1.0,
                    )
                    for name, ratio in without.items()
                ),
            ),
        ),
    )


def bell_terms(
    name: str,
    dims: int,
    size: tuple[int, int],
    realizations: int,
    seed: int,
    *,
    matrix: bool = False,
) -> xr.Dataset:
    """Return the variance terms of the Gaussian `BELL` for one sampler, by ANOVA bands.

    `size` is (number of points, half width).
    """
    n, half_width = size
    return mcs.variance_terms(
        mcs.integrand(BELL, dims),
        name,
        n,
        half_width=half_width,
        realizations=realizations,
        rng=seed,
        bands="anova",
        cross_matrix=matrix,
    )


def entries(dims: int, half_width: int) -> int:
    """Return the number of entries of the full matrix: the square of the number of frequencies."""
    return int((2 * half_width + 1) ** (2 * dims))


def subsets(dims: int, half_width: int) -> Array:
    """Return a bit mask for each frequency m. Bit i is set if m is not 0 on axis i."""
    side = np.arange(-half_width, half_width + 1)
    grids = np.meshgrid(*[side] * dims, indexing="ij")
    return np.asarray(sum(2**i * (m != 0) for i, m in enumerate(grids))).ravel()


def components(dims: int, half_width: int) -> dict[int, float]:
    """Return truncated ANOVA components: Σ |f_m|² over all frequencies of each subset of axes."""
    power = np.abs(mcs.integrand(BELL, dims).fourier_grid(half_width)).ravel() ** 2
    of = subsets(dims, half_width)
    return {int(a): float(power[of == a].sum()) for a in set(of.tolist()) if a}


def labelled_subsets(data: xr.Dataset) -> list[int]:
    """Return the subset of axes of each band, from labels such as ``constant`` and ``x0x2``."""
    names = str(data["band"].attrs["labels"]).split(", ")
    return [sum(2 ** int(axis) for axis in name.split("x")[1:]) for name in names]


def order_shares(data: xr.Dataset) -> Array:
    """Return the shares of the variance from functions of one, two, … coordinates.

    The covariance of two bands belongs half to each of them.
    """
    orders = np.array([subset.bit_count() for subset in labelled_subsets(data)])
    rows = data["band_covariance"].sum("band_other").values
    parts = [rows[orders == k].sum() for k in range(1, int(orders.max()) + 1)]
    return np.asarray(np.array(parts) / rows.sum())


def main_share(data: xr.Dataset) -> float:
    """Return the share of the variance from functions of one coordinate, including covariances."""
    alone = [k for k, subset in enumerate(labelled_subsets(data)) if subset in (1, 2, 4)]
    matrix = data["band_covariance"].values
    return float(matrix[alone].sum() / matrix.sum())


def jittered_variance(half_width: int, side: int = 8) -> float:
    """Return the variance of the bell's Fourier series up to `half_width`, in two dims.

    The points are jittered in side × side strata.
    """
    m = np.arange(-half_width, half_width + 1)
    nodes, weights = np.polynomial.legendre.leggauss(60)
    x = (np.arange(side)[:, None] + (nodes + 1) / 2) / side
    waves = np.exp(2j * np.pi * x[..., None] * m)
    series = (waves @ mcs.integrand(BELL, 1).fourier_grid(half_width).ravel()).real
    means, squares = series @ weights / 2, series**2 @ weights / 2
    return float((squares.sum() ** 2 - (means**2).sum() ** 2) / side**4)


def _shares(data: xr.Dataset, half_width: int) -> Array:
    """Return contributions as shares of their sum, for frequencies up to `half_width`."""
    values = data["contribution"].values / float(data["predicted_variance"])
    middle = len(values) // 2
    near = slice(middle - half_width, middle + half_width + 1)
    return np.asarray(values[near, near])


def _low_frequencies(data: xr.Dataset) -> Panel:
    """Return a map of contributions at low frequencies, with the numbers of the largest."""
    shares = 100.0 * _shares(data, _NEAR)
    side = np.arange(-_NEAR, _NEAR + 1.0)
    top = 1.6 * float(np.abs(shares).max())
    scale = Scale(low=-top, high=top, palette="diverging")
    said = (
        TextMark(
            x=x,
            y=y,
            text=number(float(share), 2 if abs(share) >= 10 else 1),
            color="#FFFFFF" if abs(share) > top / 2 else INK,
            side="middle",
        )
        for (x, y), share in zip(
            itertools.product(side.tolist(), repeat=2), shares.flat, strict=True
        )
        if abs(share) >= _SHOWN
    )
    ticks = {float(m): f"{m}".replace("-", "−") for m in range(-_NEAR, _NEAR + 1)}
    return Panel(
        marks=(Heatmap(values=shares.T, x=side, y=side, scale=scale, name="share"), *said),
        x=Axis(label="m₀ (cycles per unit)", ticks=ticks),
        y=Axis(label="m₁ (cycles per unit)", ticks=ticks),
        title="cₘ in % of the variance",
        square=True,
    )


def _terms_beside(data: xr.Dataset, title: str) -> Panel:
    """Return the three terms, their sum and the measured variance."""
    terms = [float(data[name]) for name in ("dc_term", "power_term", "cross_term")]
    measured = Measured.of(data, "measured_variance")
    return term_panel(terms, measured, 1e-4, title, "variance · 10⁴")


def _orders_panel(bands: dict[str, xr.Dataset]) -> Panel:
    """Return stacked bars: the variance from functions of one, two and three coordinates."""
    rows = np.array([order_shares(data) for data in bands.values()])
    base = np.cumsum(rows, axis=1) - rows
    at = np.arange(float(len(bands)))
    bars = [
        BarChart(
            at=at, value=base[:, k] + rows[:, k], base=base[:, k], lying=True, thickness=0.6,
            color=color, label=label,
        )
        for k, (label, color) in enumerate(_ORDERS.items())
    ]  # fmt: skip
    return Panel(
        marks=tuple(bars),
        x=Axis(
            label="share of the variance", low=0.0, high=1.0, ticks={0.0: "0", 0.5: "0.5", 1.0: "1"}
        ),
        y=name_axis([name.replace("latin-h", "Latin h") for name in bands]),
        title="share of functions of one, two and three coordinates",
    )


def _map_is_row_sums(dims: int, data: xr.Dataset) -> Claim:
    rows = data["cross_matrix"].values.sum(axis=1).real
    values = data["contribution"].values.ravel()
    return Claim(
        f"The contribution map is the matrix summed over its rows, {_WORDS[dims]}: largest "
        "difference relative to the largest value.",
        float(np.abs(rows - values).max() / np.abs(values).max()),
        at_most=1e-10,
    )


def _bands_are_blocks(dims: int, data: xr.Dataset) -> Claim:
    """Compare covariances of ANOVA bands with sums over blocks of the matrix.

    Both lists are sorted first, because they contain the pairs of bands in different orders.
    """
    of = subsets(dims, SMALL[dims][1])
    matrix = data["cross_matrix"].values
    blocks = [matrix[np.ix_(of == a, of == b)].sum().real for a in set(of) for b in set(of)]
    found = np.sort(data["band_covariance"].values.ravel())
    return Claim(
        f"Covariances of ANOVA bands are sums over blocks of the matrix, {_WORDS[dims]}: largest "
        "difference relative to the largest value.",
        float(np.abs(np.sort(blocks) - found).max() / np.abs(found).max()),
        at_most=1e-10,
    )


def _map_sums(dims: int, data: xr.Dataset) -> Claim:
    total, size = float(data["predicted_variance"]), data["contribution"].size
    sums = [float(data[name].sum()) for name in ("contribution", "band_covariance")]
    return Claim(
        f"Map and bands sum to the variance without a matrix, {_WORDS[dims]}, {size} frequencies: "
        "larger relative difference.",
        max(abs(each - total) for each in sums) / total,
        at_most=1e-10,
        note=f"The matrix would have {number(size**2)} entries.",
    )


def _sizes() -> Plot:
    dims, marks = np.arange(1.0, 5.0), list[Mark]()
    for half_width, color, marker in zip((256, 64, 8), PALETTE, MARKERS, strict=False):
        sizes = np.array([entries(int(d), half_width) for d in dims], float)
        label = f"K = {half_width}"
        marks.append(Line(x=dims, y=sizes, color=color, width=1.8, label=label))
        marks.append(Dots(x=dims, y=sizes, color=color, marker=marker, size=6.0, label=label))
    memory = 2**36 / _BYTES
    marks += [
        ReferenceLine(at=memory, color=INK, dashes="--", width=1.2),
        TextMark(x=3.45, y=memory, text="64 GiB of memory", side="above"),
    ]
    ticks = {float(d): str(int(d)) for d in dims}
    x = Axis(label="number of dims d", low=0.8, high=4.2, ticks=ticks)
    y = log_axis("entries of the matrix", 100.0, float(entries(4, 256)))
    return plot_of("dimensionality", Panel(marks=tuple(marks), x=x, y=y, grid=True))
