"""Names of all result variables, and the one way to make a labelled dataset of them.

Every variable an analysis returns is registered here once with its meaning, unit, dims and kind;
`dataset` attaches meaning and unit as attributes, and the provenance (seed, versions, spec strings) to
the whole; `check_variables` holds every result against what its analysis declares.
"""

from __future__ import annotations

import functools
import json
import math
from collections.abc import Collection, Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from mcspectra.core.display import register_accessor

if TYPE_CHECKING:
    import xarray as xr

__all__ = [
    "VARIABLES",
    "Variable",
    "check_variables",
    "dataset",
    "package_versions",
    "strict",
]


class Variable(NamedTuple):
    """A registered variable of results.

    Attributes
    ----------
    meaning, units
        Become the attributes ``long_name`` and ``units``.
    dims
        Its dims in order: ``m`` stands for m0, m1, …; one that ends in ``?`` may be missing. The dims
        estimator, sampler and channel may come besides. None where they differ.
    kind
        Kinds of numbers, as NumPy's letters: ``f`` floats, ``i`` integers, ``c`` complex, ``b`` booleans.
    name
        Of a variable that is not in `VARIABLES`, such as those of other packages.
    """

    meaning: str
    units: str
    dims: tuple[str, ...] | None = None
    kind: str = "f"
    name: str = ""


_FREE_DIMS = frozenset({"estimator", "sampler", "channel"})

_ROWS: Mapping[str, tuple[str, ...]] = {
    # name: meaning, unit, dims between blanks, kind
    "anisotropy": ("variance of power over direction / (mean power)²", "1", "radius"),
    "anova_share": ("c_u / variance", "1", "subset"),
    "anova_variance": ("c_u, part of the variance that subset u of the axes makes", "f²", "subset"),
    "anisotropy_db": ("variance of power over direction / (mean power)²", "dB", "radius"),
    "anisotropy_noise_db": ("anisotropy that noise alone makes", "dB", "radius"),
    "band_covariance": ("covariance of band-limited estimates", "f²", "band band_other"),
    "band_trace": ("sum of all eigenvalues of the covariance within the band", "f²", ""),
    "best_width": ("width of smoothed edges with the least mean squared error", "1"),
    "best_width_range": ("widths that may have the least mean squared error", "1"),
    "bias_squared": ("(integral of the smoothed integrand minus the original)²", "f²"),
    "bias": ("mean estimate minus the integral", "f", "n"),
    "bottleneck": ("technique of the slowest rate; −1: undecided", "1", "y? x?", "if"),
    "captured": ("predicted / measured variance", "1", "n?"),
    "captured_by_half_width": (
        "predicted / measured variance, truncated at each half width",
        "1",
        "half_width",
    ),
    "centered_discrepancy": ("centred L2 discrepancy", "1"),
    "coefficient_covariance": ("C_ml, covariance of S_m and S_l", "1", "m l", "fc"),
    "contribution": ("c_m, contribution of frequency m to the variance", "f²", "technique? m"),
    "cross_matrix": ("conj(f_m) f_l C_ml", "f²", "m l", "fc"),
    "cross_term": ("cross term Σ_{m≠l} conj(f_m) f_l C_ml", "f²", "n?"),
    "dc_term": ("dc term |f_0|² C_00", "f²", "n?"),
    "cost": ("evaluations of the integrand in an estimate", "1", "remedy step"),
    "error": ("variance at the budget, mean squared error where biased", "f²", "remedy"),
    "error_at_cost": (
        "variance at each cost, mean squared error where biased",
        "f²",
        "remedy step",
    ),
    "error_ratio": ("error / that of the set-up as given", "1", "remedy"),
    "error_ratio_ci": ("simultaneous 95 % interval of the ratio of errors", "1", "remedy bound"),
    "rank_by_rate": ("rank by rate, 1: steepest", "1", "remedy", "i"),
    "rate_difference": ("rate minus that of the set-up as given", "1", "remedy"),
    "rate_difference_ci": (
        "simultaneous 95 % interval of the difference of rates",
        "1",
        "remedy bound",
    ),
    "eigenvalue": ("eigenvalue of the covariance, variance of a mode", "f²", "mode"),
    "eigenvalue_residual": ("bound of the distance to an eigenvalue", "f²", "mode"),
    "eigenvalue_share": ("eigenvalue / trace", "1", "mode"),
    "diaphony": ("diaphony, spectrum weighted by 1/Π max(1, m²)", "1"),
    "effective_dimension_superposition": (
        "least size of subsets with 99 % of the variance",
        "1",
        "",
    ),
    "effective_dimension_truncation": (
        "least number of first axes with 99 % of the variance",
        "1",
        "",
    ),
    "elementary_intervals": ("whether all elementary intervals hold their share (1: yes)", "1"),
    "energy_share": ("part of ∫f² within the half width", "1", "route"),
    "exact_variance": ("exact variance", "f²", "n"),
    "exponent_fit_chi2": ("lack of fit of the exponent, χ² per degree of freedom", "1", ""),
    "fit_chi2": ("lack of fit of the rate, χ² per degree of freedom", "1", "strategy? y? x?"),
    "fit_first_n": ("smallest number of points of the fit", "1", ""),
    "gain": ("gain coefficient Γ of nested scrambling, random points: 1", "1"),
    "generalized_l2_discrepancy": ("generalised L2 discrepancy, over all projections", "1"),
    "higher_order_variance": ("part of the variance of all larger subsets", "f²", ""),
    "image": ("mean radiance of each pixel", "W/(m² sr)"),
    "improvement": ("variance less than as given (1), more (−1), undecided (0)", "1"),
    "incident_radiance": ("radiance of the lights that count, from each direction", "W/(m² sr)"),
    "kurtosis": ("kurtosis of the estimates; normal: 3", "1", ""),
    "l2_star_discrepancy": ("L2 star discrepancy", "1"),
    "low_frequency_exponent": ("b of power ∝ |m|^b at low frequencies", "1", ""),
    "mean": ("mean estimate", "f", "strategy? n? y? x?"),
    "mean_dimension": ("mean size of subsets, weighted by c_u", "1", ""),
    "mean_coefficient": (
        "mean coefficient ⟨S_m⟩; 0 at integer m ≠ 0 for unbiased sets",
        "1",
        "m frequency?",
        "c",
    ),
    "mean_nearest_distance": ("mean toroidal distance to the nearest point", "1"),
    "mean_projected_diaphony": ("mean diaphony of the 2-D projections", "1"),
    "mean_projected_discrepancy": ("mean star discrepancy of the 2-D projections", "1"),
    "mean_projected_distance": ("mean minimum distance of the 2-D projections", "1"),
    "measured_variance": ("measured variance of the estimate (ddof = 1)", "f²", "n?"),
    "minimum_distance": ("smallest toroidal distance of two points", "1"),
    "mixture_discrepancy": ("mixture L2 discrepancy", "1"),
    "mode_contribution": ("part of the variance of the estimate along the mode", "f²", "mode"),
    "mode_vector": (
        "pattern of the mode over the frequencies, of norm 1",
        "1",
        "mode technique? m",
        "fc",
    ),
    "mse": ("mean squared error against the integral", "f²", "n"),
    "noise_edge": ("largest sample eigenvalue of a flat spectrum of the same trace", "f²", ""),
    "pair_correlation": ("pair correlation g(r), 1 for random points", "1", "r"),
    "points": ("points of one realisation", "1", "point axis"),
    "power": ("expected power ⟨|S_m|²⟩; random points: ∫1/p / n", "1", "m frequency?"),
    "power_contribution": (
        "|f_m|² C_mm, the diagonal part of the contribution",
        "f²",
        "technique? m",
    ),
    "power_term": ("power term Σ_{m≠0} |f_m|² C_mm", "f²", "n?"),
    "predicted_variance": ("predicted variance, dc + power + cross", "f²", "n?"),
    "radial_power": ("expected power, mean over directions", "1", "radius"),
    "rate": (
        "fitted exponent of variance in n; random sampling: −1",
        "1",
        "remedy? strategy? y? x?",
    ),
    "reached": ("whether the wanted precision was reached (1: yes)", "1", "n?", "i"),
    "realizations_used": ("realisations used", "1", "n?", "i"),
    "relative_minimum_distance": ("minimum distance / that of the densest packing", "1"),
    "slice_power": ("expected power along a direction", "1", "slice multiple"),
    "route_variance": ("variance by this route", "f²", "route"),
    "skewness": ("skewness of the estimates; normal: 0", "1", ""),
    "smoothing_bias": ("integral of the smoothed integrand minus the original", "f"),
    "star_discrepancy": ("star discrepancy", "1"),
    "strata_offset": ("offset of strata in sides of a stratum", "1"),
    "t_value": ("quality parameter t of the (t, m, d)-net", "1"),
    "technique_covariance": (
        "covariance of the parts of the estimate of two techniques",
        "f²",
        "n? technique technique_other",
    ),
    "technique_cross_term": ("cross term of two techniques", "f²", "n? technique technique_other"),
    "technique_dc_term": ("dc term of two techniques", "f²", "n? technique technique_other"),
    "technique_power_term": ("power term of two techniques", "f²", "n? technique technique_other"),
    "technique_rate": ("fitted exponent of the technique's own variance in n", "1", "technique"),
    "technique_variance": (
        "variance of the technique's part of the estimate",
        "f²",
        "n? technique",
    ),
    "total_variance": ("part of the variance of all subsets that hold the axis", "f²", "axis"),
    "transport_cost": ("mean squared distance of moving uniform mass to the points", "1"),
    "truncation_share": ("share of the variance of the first axes", "1", "axes"),
    "truncated_variance": (
        "variance of the estimate truncated at each half width",
        "f²",
        "half_width",
    ),
    "variance": ("variance of the estimate (ddof = 1)", "f²", "strategy? n? y? x?"),
    "variance_ratio": ("variance / variance of the estimate as given", "1"),
    "variance_relative_se": (
        "standard error of the variance / variance",
        "1",
        "strategy? n? y? x?",
    ),
    "wedge_power": ("expected power, mean over a wedge of directions", "1", "angle"),
    "distortion": ("diameter of a small square's image / that of a square of its area", "1"),
    "face_jump": ("jump of g from a side of the square to the opposite one", "f"),
    "jump": ("jump of the warp to the next cell", "1"),
    "jump_length": ("length of the curves where the warp jumps", "1"),
    "max_stretch": ("largest ratio of singular values of the warp's derivative", "1"),
    "mean_jump": ("mean jump of the warp", "1"),
    "mean_stretch": ("geometric mean of the stretch", "1"),
    "neighbor_expansion": ("distance of neighbouring cells' images, root mean square", "cells"),
    "primary_jump": ("jump of g to the next cell", "f"),
    "primary_jump_height": ("mean jump of g", "f"),
    "primary_jump_length": ("length of the jumps of g", "1"),
    "primary_pole": ("whether g is unbounded (1: yes)", "1"),
    "primary_value": ("primary-space integrand g(u) = f(T(u)) / p(T(u))", "f"),
    "reciprocal_unbounded": ("whether 1/p is unbounded (1: yes)", "1"),
    "reflected_radiance": ("radiance reflected to the camera, per solid angle", "W/(m² sr²)"),
    "stretch": ("ratio of singular values of the warp's derivative", "1"),
    "warped": ("warp T at the centres of cells", "1"),
    "worst_projected_diaphony": ("largest diaphony of the 2-D projections", "1"),
    "worst_projected_discrepancy": ("largest star discrepancy of the 2-D projections", "1"),
    "worst_projected_distance": ("smallest minimum distance of the 2-D projections", "1"),
    "dominant_technique": ("technique of the larger variance; −1: undecided", "1", "y x"),
    "mis_gain": ("variance of the better single strategy / variance of MIS", "1", "y x"),
    "predicted_ratio": ("predicted / measured variance at the largest n", "1", "strategy y x"),
    "wraparound_discrepancy": ("wrap-around L2 discrepancy", "1"),
}


_VARIABLES = {
    name: Variable(meaning, units, tuple(more[0].split()) if more else None, *more[1:])
    for name, (meaning, units, *more) in _ROWS.items()
}
VARIABLES: Mapping[str, Variable] = {
    **{
        f"{n}_se": Variable(f"standard error: {v.meaning}", v.units, v.dims)
        for n, v in _VARIABLES.items()
    },
    **{
        f"{n}_ci": Variable(
            f"95 % interval: {v.meaning}", v.units, None if v.dims is None else (*v.dims, "bound")
        )
        for n, v in _VARIABLES.items()
    },
    **_VARIABLES,
}
"""Variables by name; those with ``_se`` and ``_ci`` are the errors and intervals of the others."""


def dataset(
    variables: Mapping[str, tuple[tuple[str, ...], Any]],
    coords: Mapping[str, Any] | None = None,
    *,
    drop: Collection[str] = (),
    **provenance: Any,
) -> xr.Dataset:
    """Make a dataset of registered variables, name -> (dims, values), with provenance attributes.

    Dims to `drop` have one value, such as the channel of a scalar; they are left out.
    """
    import xarray as xr

    register_accessor()
    arrays = {}
    for name, (dims, values) in variables.items():
        if any(dim in drop for dim in dims):
            values = values[tuple(0 if dim in drop else slice(None) for dim in dims)]
        about = {"long_name": VARIABLES[name].meaning, "units": VARIABLES[name].units}
        arrays[name] = (tuple(dim for dim in dims if dim not in drop), values, about)

    # Attributes are what every storage format can hold: numbers, strings, or JSON text
    attributes: dict[str, Any] = {}
    for key, value in provenance.items():
        plain = value.item() if isinstance(value, np.generic) else value
        if plain is not None:
            attributes[key] = plain if isinstance(plain, str | int | float) else json.dumps(plain)
    return xr.Dataset(arrays, coords=coords, attrs={**attributes, **package_versions()})


def check_variables(result: xr.Dataset, declared: Sequence[str | Variable], analysis: str) -> None:
    """Hold a result against the variables that its analysis declares.

    Raises
    ------
    TypeError
        A variable is not declared, or has other dims or another kind of numbers.
    """
    known = {v if isinstance(v, str) else v.name: v for v in declared}
    for name, values in result.data_vars.items():
        about = known.get(str(name))
        if about is None:
            raise TypeError(f"{analysis} gives the variable {name!r}, which it does not declare.")
        about = VARIABLES[about] if isinstance(about, str) else about
        if values.dtype.kind not in about.kind:
            raise TypeError(f"{analysis}: {name} holds {values.dtype}, declared is {about.kind!r}.")
        found = [str(d) for d in values.dims if d not in _FREE_DIMS or d in (about.dims or ())]
        if about.dims is not None and not _dims_fit(found, about.dims):
            raise TypeError(f"{analysis}: {name} has the dims {found}, declared are {about.dims}.")


def _dims_fit(found: list[str], declared: Sequence[str]) -> bool:
    """Whether dims are the declared ones: ``m`` any of m0, m1, …, those with ``?`` or not."""
    rest = list(found)
    for dim in declared:
        name = dim.removesuffix("?")
        if name == "m":
            while rest and rest[0].rstrip("0123456789") == "m":
                rest.pop(0)
        elif rest and rest[0] == name:
            rest.pop(0)
        elif not dim.endswith("?"):
            return False
    return not rest


@functools.cache
def package_versions() -> dict[str, str]:
    """Versions of this package and of those that its numbers depend on."""
    found = {}
    for name in ("mcspectra", "numpy", "scipy", "numba", "finufft"):
        try:
            found[f"version_{name}"] = version(name)
        except PackageNotFoundError:
            found[f"version_{name}"] = "unknown"
    return found


def strict(value: Any) -> Any:
    """Return what strict JSON can say: lists for arrays, null for NaN and infinity, texts for paths."""
    if isinstance(value, Mapping):
        return {str(key): strict(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [strict(item) for item in value]
    if isinstance(value, np.ndarray | np.generic):
        return strict(value.tolist())
    if isinstance(value, complex):
        return {"re": strict(value.real), "im": strict(value.imag)}
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return str(value) if isinstance(value, Path) else value
