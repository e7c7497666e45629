"""Names of all result variables, and the one way to make a labelled dataset of them.

Every variable an analysis returns is registered here once with its meaning, unit, dims and kind;
`dataset` attaches meaning and unit as attributes, and the provenance (seed, versions, spec strings) to
the whole; `check_variables` holds every result against what its analysis declares.
"""

from __future__ import annotations

import functools
import json
from collections.abc import Collection, Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from mcspectra.core.display import register_accessor

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["VARIABLES", "Variable", "check_variables", "dataset", "package_versions"]


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

_VARIABLES: Mapping[str, Variable] = {
    # name: meaning, unit, dims, kind
    "anisotropy": Variable("variance of power over direction / (mean power)²", "1", ("radius",)),
    "anova_share": Variable("c_u / variance", "1", ("subset",)),
    "anova_variance": Variable(
        "c_u, part of the variance that subset u of the axes makes", "f²", ("subset",)
    ),
    "anisotropy_db": Variable(
        "variance of power over direction / (mean power)²", "dB", ("radius",)
    ),
    "anisotropy_noise_db": Variable("anisotropy that noise alone makes", "dB", ("radius",)),
    "band_covariance": Variable(
        "covariance of band-limited estimates", "f²", ("band", "band_other")
    ),
    "band_trace": Variable("sum of all eigenvalues of the covariance within the band", "f²", ()),
    "best_width": Variable("width of smoothed edges with the least mean squared error", "1"),
    "best_width_range": Variable("widths that may have the least mean squared error", "1"),
    "bias_squared": Variable("(integral of the smoothed integrand minus the original)²", "f²"),
    "bias": Variable("mean estimate minus the integral", "f", ("n",)),
    "bottleneck": Variable("technique of the slowest rate; −1: undecided", "1", ("y?", "x?"), "if"),
    "captured": Variable("predicted / measured variance", "1", ("n?",)),
    "captured_by_half_width": Variable(
        "predicted / measured variance, truncated at each half width", "1", ("half_width",)
    ),
    "centered_discrepancy": Variable("centred L2 discrepancy", "1"),
    "coefficient_covariance": Variable("C_ml, covariance of S_m and S_l", "1", ("m", "l"), "fc"),
    "contribution": Variable(
        "c_m, contribution of frequency m to the variance", "f²", ("technique?", "m")
    ),
    "cross_matrix": Variable("conj(f_m) f_l C_ml", "f²", ("m", "l"), "fc"),
    "cross_term": Variable("cross term Σ_{m≠l} conj(f_m) f_l C_ml", "f²", ("n?",)),
    "dc_term": Variable("dc term |f_0|² C_00", "f²", ("n?",)),
    "cost": Variable("evaluations of the integrand in an estimate", "1", ("remedy", "step")),
    "error": Variable("variance at the budget, mean squared error where biased", "f²", ("remedy",)),
    "error_at_cost": Variable(
        "variance at each cost, mean squared error where biased", "f²", ("remedy", "step")
    ),
    "error_ratio": Variable("error / that of the set-up as given", "1", ("remedy",)),
    "error_ratio_ci": Variable(
        "simultaneous 95 % interval of the ratio of errors", "1", ("remedy", "bound")
    ),
    "rank_by_rate": Variable("rank by rate, 1: steepest", "1", ("remedy",), "i"),
    "rate_difference": Variable("rate minus that of the set-up as given", "1", ("remedy",)),
    "rate_difference_ci": Variable(
        "simultaneous 95 % interval of the difference of rates", "1", ("remedy", "bound")
    ),
    "eigenvalue": Variable("eigenvalue of the covariance, variance of a mode", "f²", ("mode",)),
    "eigenvalue_residual": Variable("bound of the distance to an eigenvalue", "f²", ("mode",)),
    "eigenvalue_share": Variable("eigenvalue / trace", "1", ("mode",)),
    "diaphony": Variable("diaphony, spectrum weighted by 1/Π max(1, m²)", "1"),
    "effective_dimension_superposition": Variable(
        "least size of subsets with 99 % of the variance", "1", ()
    ),
    "effective_dimension_truncation": Variable(
        "least number of first axes with 99 % of the variance", "1", ()
    ),
    "elementary_intervals": Variable(
        "whether all elementary intervals hold their share (1: yes)", "1"
    ),
    "energy_share": Variable("part of ∫f² within the half width", "1", ("route",)),
    "exact_variance": Variable("exact variance", "f²", ("n",)),
    "exponent_fit_chi2": Variable("lack of fit of the exponent, χ² per degree of freedom", "1", ()),
    "fit_chi2": Variable(
        "lack of fit of the rate, χ² per degree of freedom", "1", ("strategy?", "y?", "x?")
    ),
    "fit_first_n": Variable("smallest number of points of the fit", "1", ()),
    "gain": Variable("gain coefficient Γ of nested scrambling, random points: 1", "1"),
    "generalized_l2_discrepancy": Variable("generalised L2 discrepancy, over all projections", "1"),
    "higher_order_variance": Variable("part of the variance of all larger subsets", "f²", ()),
    "image": Variable("mean radiance of each pixel", "W/(m² sr)"),
    "improvement": Variable("variance less than as given (1), more (−1), undecided (0)", "1"),
    "incident_radiance": Variable(
        "radiance of the lights that count, from each direction", "W/(m² sr)"
    ),
    "kurtosis": Variable("kurtosis of the estimates; normal: 3", "1", ()),
    "l2_star_discrepancy": Variable("L2 star discrepancy", "1"),
    "low_frequency_exponent": Variable("b of power ∝ |m|^b at low frequencies", "1", ()),
    "mean": Variable("mean estimate", "f", ("strategy?", "n?", "y?", "x?")),
    "mean_dimension": Variable("mean size of subsets, weighted by c_u", "1", ()),
    "mean_coefficient": Variable(
        "mean coefficient ⟨S_m⟩; 0 at integer m ≠ 0 for unbiased sets",
        "1",
        ("m", "frequency?"),
        "c",
    ),
    "mean_nearest_distance": Variable("mean toroidal distance to the nearest point", "1"),
    "mean_projected_diaphony": Variable("mean diaphony of the 2-D projections", "1"),
    "mean_projected_discrepancy": Variable("mean star discrepancy of the 2-D projections", "1"),
    "mean_projected_distance": Variable("mean minimum distance of the 2-D projections", "1"),
    "measured_variance": Variable("measured variance of the estimate (ddof = 1)", "f²", ("n?",)),
    "minimum_distance": Variable("smallest toroidal distance of two points", "1"),
    "mixture_discrepancy": Variable("mixture L2 discrepancy", "1"),
    "mode_contribution": Variable(
        "part of the variance of the estimate along the mode", "f²", ("mode",)
    ),
    "mode_vector": Variable(
        "pattern of the mode over the frequencies, of norm 1",
        "1",
        ("mode", "technique?", "m"),
        "fc",
    ),
    "mse": Variable("mean squared error against the integral", "f²", ("n",)),
    "noise_edge": Variable(
        "largest sample eigenvalue of a flat spectrum of the same trace", "f²", ()
    ),
    "pair_correlation": Variable("pair correlation g(r), 1 for random points", "1", ("r",)),
    "points": Variable("points of one realisation", "1", ("point", "axis")),
    "power": Variable("expected power ⟨|S_m|²⟩; random points: ∫1/p / n", "1", ("m", "frequency?")),
    "power_contribution": Variable(
        "|f_m|² C_mm, the diagonal part of the contribution", "f²", ("technique?", "m")
    ),
    "power_term": Variable("power term Σ_{m≠0} |f_m|² C_mm", "f²", ("n?",)),
    "predicted_variance": Variable("predicted variance, dc + power + cross", "f²", ("n?",)),
    "radial_power": Variable("expected power, mean over directions", "1", ("radius",)),
    "rate": Variable(
        "fitted exponent of variance in n; random sampling: −1",
        "1",
        ("remedy?", "strategy?", "y?", "x?"),
    ),
    "reached": Variable("whether the wanted precision was reached (1: yes)", "1", ("n?",), "i"),
    "realizations_used": Variable("realisations used", "1", ("n?",), "i"),
    "relative_minimum_distance": Variable("minimum distance / that of the densest packing", "1"),
    "slice_power": Variable("expected power along a direction", "1", ("slice", "multiple")),
    "route_variance": Variable("variance by this route", "f²", ("route",)),
    "skewness": Variable("skewness of the estimates; normal: 0", "1", ()),
    "smoothing_bias": Variable("integral of the smoothed integrand minus the original", "f"),
    "star_discrepancy": Variable("star discrepancy", "1"),
    "strata_offset": Variable("offset of strata in sides of a stratum", "1"),
    "t_value": Variable("quality parameter t of the (t, m, d)-net", "1"),
    "technique_covariance": Variable(
        "covariance of the parts of the estimate of two techniques",
        "f²",
        ("n?", "technique", "technique_other"),
    ),
    "technique_cross_term": Variable(
        "cross term of two techniques", "f²", ("n?", "technique", "technique_other")
    ),
    "technique_dc_term": Variable(
        "dc term of two techniques", "f²", ("n?", "technique", "technique_other")
    ),
    "technique_power_term": Variable(
        "power term of two techniques", "f²", ("n?", "technique", "technique_other")
    ),
    "technique_rate": Variable(
        "fitted exponent of the technique's own variance in n", "1", ("technique",)
    ),
    "technique_variance": Variable(
        "variance of the technique's part of the estimate", "f²", ("n?", "technique")
    ),
    "total_variance": Variable(
        "part of the variance of all subsets that hold the axis", "f²", ("axis",)
    ),
    "transport_cost": Variable("mean squared distance of moving uniform mass to the points", "1"),
    "truncation_share": Variable("share of the variance of the first axes", "1", ("axes",)),
    "truncated_variance": Variable(
        "variance of the estimate truncated at each half width", "f²", ("half_width",)
    ),
    "variance": Variable(
        "variance of the estimate (ddof = 1)", "f²", ("strategy?", "n?", "y?", "x?")
    ),
    "variance_ratio": Variable("variance / variance of the estimate as given", "1"),
    "variance_relative_se": Variable(
        "standard error of the variance / variance", "1", ("strategy?", "n?", "y?", "x?")
    ),
    "wedge_power": Variable("expected power, mean over a wedge of directions", "1", ("angle",)),
    "distortion": Variable(
        "diameter of a small square's image / that of a square of its area", "1"
    ),
    "face_jump": Variable("jump of g from a side of the square to the opposite one", "f"),
    "jump": Variable("jump of the warp to the next cell", "1"),
    "jump_length": Variable("length of the curves where the warp jumps", "1"),
    "max_stretch": Variable("largest ratio of singular values of the warp's derivative", "1"),
    "mean_jump": Variable("mean jump of the warp", "1"),
    "mean_stretch": Variable("geometric mean of the stretch", "1"),
    "neighbor_expansion": Variable(
        "distance of neighbouring cells' images, root mean square", "cells"
    ),
    "primary_jump": Variable("jump of g to the next cell", "f"),
    "primary_jump_height": Variable("mean jump of g", "f"),
    "primary_jump_length": Variable("length of the jumps of g", "1"),
    "primary_pole": Variable("whether g is unbounded (1: yes)", "1"),
    "primary_value": Variable("primary-space integrand g(u) = f(T(u)) / p(T(u))", "f"),
    "reciprocal_unbounded": Variable("whether 1/p is unbounded (1: yes)", "1"),
    "reflected_radiance": Variable(
        "radiance reflected to the camera, per solid angle", "W/(m² sr²)"
    ),
    "stretch": Variable("ratio of singular values of the warp's derivative", "1"),
    "warped": Variable("warp T at the centres of cells", "1"),
    "worst_projected_diaphony": Variable("largest diaphony of the 2-D projections", "1"),
    "worst_projected_discrepancy": Variable("largest star discrepancy of the 2-D projections", "1"),
    "worst_projected_distance": Variable("smallest minimum distance of the 2-D projections", "1"),
    "dominant_technique": Variable(
        "technique of the larger variance; −1: undecided", "1", ("y", "x")
    ),
    "mis_gain": Variable(
        "variance of the better single strategy / variance of MIS", "1", ("y", "x")
    ),
    "predicted_ratio": Variable(
        "predicted / measured variance at the largest n", "1", ("strategy", "y", "x")
    ),
    "wraparound_discrepancy": Variable("wrap-around L2 discrepancy", "1"),
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
    attributes = {key: _plain(value) for key, value in provenance.items() if value is not None}
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


def _plain(value: Any) -> Any:
    """Return what every storage format can hold: numbers, strings, or JSON text."""
    if isinstance(value, np.generic):
        return value.item()
    return value if isinstance(value, str | int | float) else json.dumps(value)
