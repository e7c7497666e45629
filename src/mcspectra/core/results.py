"""Names of all variables in results, and the function that makes labeled datasets of them.

Each variable of a result is registered here once, with its meaning, unit, dims and type.
`dataset` gives each variable its meaning and unit as attributes.
The whole dataset has its provenance as attributes: seed, versions and spec strings.
`check_variables` compares a result with the declaration of its analysis.
"""

from __future__ import annotations

import functools
import json
import math
import re
from collections.abc import Collection, Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from mcspectra.core.display import register_accessor, shown
from mcspectra.core.errors import AnalysisError

if TYPE_CHECKING:
    import xarray as xr

__all__ = [
    "VARIABLES",
    "Variable",
    "attributes_of",
    "check_variables",
    "coordinate",
    "dataset",
    "package_versions",
    "strict_json",
]


class Variable(NamedTuple):
    """A variable of results, as it is registered.

    Attributes
    ----------
    meaning, units
        Texts of the attributes ``long_name`` and ``units``.
    dims
        Dims of the variable, in order. None if the dims vary.
        ``m`` stands for m0, m1, …; a dim whose name ends in ``?`` is optional.
        The dims estimator, sampler and channel may be added to any variable.
    kind
        Types of numbers, in NumPy's letters: ``f`` float, ``i`` integer, ``c`` complex, ``b`` bool.
    name
        Name of a variable that is not in `VARIABLES`, for example one of another package.
    """

    meaning: str
    units: str
    dims: tuple[str, ...] | None = None
    kind: str = "f"
    name: str = ""


_FREE_DIMS = frozenset({"estimator", "sampler", "channel"})

_TABLE = """\
name | kind | unit | dims, any where they differ | meaning
anisotropy | f | 1 | radius | variance of power over direction / (mean power)²
anova_share | f | 1 | subset | c_u / variance
anova_variance | f | f² | subset | c_u, part of the variance that subset u of the axes makes
anisotropy_db | f | dB | radius | variance of power over direction / (mean power)²
anisotropy_noise_db | f | dB | radius | anisotropy that noise alone makes
band_covariance | f | f² | band band_other | covariance of band-limited estimates
band_trace | f | f² | | sum of all eigenvalues of the covariance within the band
bend_n | f | 1 | method? | \
number of points at which the predicted rate changes to its limit; NaN: none known
best_width | f | 1 | any | width of smoothed edges with the least mean squared error
best_width_range | f | 1 | any | widths that may have the least mean squared error
bias_squared | f | f² | any | (integral of the smoothed integrand minus the original)²
bias | f | f | n | mean estimate minus the integral
bottleneck | if | 1 | y? x? | technique of the slowest rate; −1: undecided
captured | f | 1 | n? | predicted / measured variance
captured_by_half_width | f | 1 | half_width | \
predicted / measured variance, truncated at each half width
centered_discrepancy | f | 1 | any | centered L2 discrepancy
coefficient_covariance | fc | 1 | m l | C_ml, covariance of S_m and S_l
contribution | f | f² | technique? m | c_m, contribution of frequency m to the variance
cross_matrix | fc | f² | m l | conj(f_m) f_l C_ml
cross_term | f | f² | n? | cross term Σ_{m≠l} conj(f_m) f_l C_ml
dc_term | f | f² | n? | dc term |f_0|² C_00
cost | f | 1 | remedy step | evaluations of the integrand in an estimate
error | f | f² | remedy | variance at the budget, mean squared error where biased
error_at_cost | f | f² | remedy step | variance at each cost, mean squared error where biased
error_ratio | f | 1 | remedy | \
variance (mean squared error where biased) / that of the set-up as given
error_ratio_ci | f | 1 | remedy bound | simultaneous 95 % interval of the ratio of variances
rank | f | 1 | sampler integrand | rank by n · variance at the largest n, 1: least
rank_ci | f | 1 | sampler integrand bound | simultaneous 95 % interval of the rank
pictured_n | f | 1 | sampler | number of points of the spectrum and the pair correlation
spectrum_sets | f | 1 | sampler | number of sets over which the spectrum is averaged
pair_sets | f | 1 | sampler | number of sets over which the pair correlation is averaged
quality_sets | f | 1 | sampler n | number of sets over which the figures of quality are averaged
points_made | f | 1 | sampler integrand n | number of points taken, the nearest that can be made
points_per_second | f | 1/s | sampler n | points made in a second by one thread
rank_by_rate | i | 1 | remedy | rank by rate, 1: steepest
rate_difference | f | 1 | remedy | rate minus that of the set-up as given
rate_difference_ci | f | 1 | remedy bound | simultaneous 95 % interval of the difference of rates
eigenvalue | f | f² | mode | eigenvalue of the covariance, variance of a mode
eigenvalue_residual | f | f² | mode | bound of the distance to an eigenvalue
eigenvalue_share | f | 1 | mode | eigenvalue / trace
diaphony | f | 1 | any | diaphony, spectrum weighted by 1/Π max(1, m²)
effective_dimension_superposition | f | 1 | | least size of subsets with 99 % of the variance
effective_dimension_truncation | f | 1 | | least number of first axes with 99 % of the variance
estimate | f | f | any | estimates, one for each realization
elementary_intervals | f | 1 | any | whether all elementary intervals hold their share (1: yes)
energy_share | f | 1 | method? n? | part of ∫f² that is counted term by term
exact_variance | f | f² | n | exact variance
exponent_fit_chi2 | f | 1 | | lack of fit of the exponent, χ² per degree of freedom
fit_chi2 | f | 1 | strategy? y? x? | lack of fit of the rate, χ² per degree of freedom
fit_first_n | f | 1 | | smallest number of points of the fit
gain | f | 1 | any | gain coefficient Γ of nested scrambling, random points: 1
generalized_l2_discrepancy | f | 1 | any | generalized L2 discrepancy, over all projections
higher_order_share | f | 1 | | share of the variance of all larger subsets
higher_order_variance | f | f² | | part of the variance of all larger subsets
image | f | W/(m² sr) | any | mean radiance of each pixel
improvement | f | 1 | any | variance less than as given (1), more (−1), undecided (0)
incident_radiance | f | W/(m² sr) | any | radiance of the lights that count, from each direction
kurtosis | f | 1 | | kurtosis of the estimates; normal: 3
l2_star_discrepancy | f | 1 | any | L2 star discrepancy
light_mean | f | f | light | what a light gives to the integral, mean over random paths
light_probability | f | 1 | light | how often a light is chosen
light_selection | f | 1 | light | how often a light had better be chosen, by second moments
light_share | f | 1 | light | \
Cov(f_j, f) / Var(f), part of the variance of a random path that light j makes
limit_rate | f | 1 | method? | \
exponent that the predicted variance tends to at large n; NaN: not known
local_rate | f | 1 | method? n | exponent of the predicted variance between neighboring n
low_frequency_exponent | f | 1 | | b of power ∝ |m|^b at low frequencies
mean | f | f | strategy? quantity? n? y? x? | mean estimate
mcse | f | f | quantity? | standard error of the mean of chains
ess | f | 1 | quantity? | \
effective number of draws: variance of the draws / squared error of their mean
burn_in | i | 1 | quantity? | draws at the start of each chain that are left out
spectrum_at_zero | f | f² | quantity? | spectral density S(0) of a chain in time
error_share | f | 1 | quantity? band | part of the squared error of the mean from these frequencies
draw_share | f | 1 | quantity? band | part of the variance of the draws from these frequencies
chain_spectrum | f | f² | quantity? band | measured spectral density of a chain, mean over the band
fitted_spectrum | f | f² | quantity? band | fitted spectral density of a chain, mean over the band
mean_dimension | f | 1 | | mean size of subsets, weighted by c_u
mean_coefficient | c | 1 | m frequency? | \
mean coefficient ⟨S_m⟩; 0 at integer m ≠ 0 for unbiased sets
mean_nearest_distance | f | 1 | any | mean toroidal distance to the nearest point
mean_projected_diaphony | f | 1 | any | mean diaphony of the 2-D projections
mean_projected_discrepancy | f | 1 | any | mean star discrepancy of the 2-D projections
mean_projected_distance | f | 1 | any | mean minimum distance of the 2-D projections
measured_variance | f | f² | n? | measured variance of the estimate (ddof = 1)
minimum_distance | f | 1 | any | smallest toroidal distance of two points
mixture_discrepancy | f | 1 | any | mixture L2 discrepancy
mode_contribution | f | f² | mode | part of the variance of the estimate along the mode
mode_vector | fc | 1 | mode technique? m | pattern of the mode over the frequencies, of norm 1
mse | f | f² | n | mean squared error against the integral
noise_edge | f | f² | | largest sample eigenvalue of a flat spectrum of the same trace
planned_error | f | f | | predicted root mean square error at the planned count
target_variance | f | f² | | square of the root mean square error that is wanted
planned_n | f | 1 | | least number of points for which the error is predicted to be reached
planned_n_ci | f | 1 | bound | its ends where variances are at the ends of their 95 % intervals
pair_correlation | f | 1 | r | pair correlation g(r), 1 for random points
points | f | 1 | point axis | points of one realization
power | f | 1 | m frequency? | expected power ⟨|S_m|²⟩; random points: ∫1/p / n
power_contribution | f | f² | technique? m | |f_m|² C_mm, the diagonal part of the contribution
power_term | f | f² | n? | power term Σ_{m≠0} |f_m|² C_mm
predicted_rate | f | 1 | method? | exponent of the predicted variance in n; random sampling: −1
predicted_variance | f | f² | method? n? | predicted variance
radial_power | f | 1 | radius | expected power, mean over directions
calls | i | 1 | | evaluations of the integrand that were made
integral | f | f | | estimate of the integral
rate | f | 1 | remedy? strategy? y? x? | fitted exponent of variance in n; random sampling: −1
reached | i | 1 | n? | whether the wanted precision was reached (1: yes)
realizations_used | i | 1 | n? | realizations used
rmse | f | f | | root mean square error of an estimate of the whole budget
relative_minimum_distance | f | 1 | any | minimum distance / distance in the densest packing
slice_power | f | 1 | slice multiple | expected power along a direction
skewness | f | 1 | | skewness of the estimates; normal: 0
smoothing_bias | f | f | any | integral of the smoothed integrand minus the original
star_discrepancy | f | 1 | any | star discrepancy
strata_offset | f | 1 | any | offset of strata in sides of a stratum
t_value | f | 1 | any | quality parameter t of the (t, m, d)-net
tail_term | f | f² | | variance of what is beyond the half width, if points are random to it
tail_variance | f | f² | method? n | \
part of the predicted variance beyond the terms that are counted
technique_covariance | f | f² | n? technique technique_other | \
covariance of the parts of the estimate of two techniques
technique_cross_term | f | f² | n? technique technique_other | cross term of two techniques
technique_dc_term | f | f² | n? technique technique_other | dc term of two techniques
technique_power_term | f | f² | n? technique technique_other | power term of two techniques
technique_rate | f | 1 | technique | fitted exponent of the technique's own variance in n
technique_variance | f | f² | n? technique | variance of the technique's part of the estimate
total_share | f | 1 | axis | share of the variance of all subsets that hold the axis
total_variance | f | f² | axis | part of the variance of all subsets that hold the axis
transport_cost | f | 1 | any | transport cost of uniform mass to the points (mean squared distance)
truncation_share | f | 1 | axes | share of the variance of the first axes
truncated_variance | f | f² | half_width | variance of the estimate truncated at each half width
variance | f | f² | strategy? n? y? x? | variance of the estimate (ddof = 1)
variance_ratio | f | 1 | any | variance / variance of the estimate as given
variance_relative_se | f | 1 | strategy? n? y? x? | standard error of the variance / variance
wedge_power | f | 1 | angle | expected power, mean over a wedge of directions
density_value | f | 1 | any | density p(x) at the centers of cells
distortion | f | 1 | any | diameter of a small square's image / that of a square of its area
face_jump | f | f | any | jump of g from a side of the square to the opposite one
integrand_power | f | f² | technique? m | |f_m|², power of the integrand
integrand_value | f | f | any | integrand f(x), or g(u) without a domain, at the centers of cells
jump | f | 1 | any | jump of the warp to the next cell
jump_length | f | 1 | any | length of the curves where the warp jumps
max_stretch | f | 1 | any | largest ratio of singular values of the warp's derivative
mean_jump | f | 1 | any | mean jump of the warp
mean_stretch | f | 1 | any | geometric mean of the stretch
neighbor_expansion | f | cells | any | distance of neighboring cells' images, root mean square
primary_jump | f | f | any | jump of g to the next cell
primary_jump_height | f | f | any | mean jump of g
primary_jump_length | f | 1 | any | length of the jumps of g
primary_pole | f | 1 | any | whether g is unbounded (1: yes)
primary_value | f | f | any | primary-space integrand g(u) = f(T(u)) / p(T(u))
reciprocal_unbounded | f | 1 | any | whether 1/p is unbounded (1: yes)
reflected_radiance | f | W/(m² sr²) | any | radiance reflected to the camera, per solid angle
sliding_variance | f | f² | any | variance of jittered points if all strata are moved along axis 0
stratum_variance | f | f² | any | part of the variance of jittered points from each stratum
stretch | f | 1 | any | ratio of singular values of the warp's derivative
warped | f | 1 | any | warp T at the centers of cells
worst_projected_diaphony | f | 1 | any | largest diaphony of the 2-D projections
worst_projected_discrepancy | f | 1 | any | largest star discrepancy of the 2-D projections
worst_projected_distance | f | 1 | any | smallest minimum distance of the 2-D projections
dominant_technique | f | 1 | y x | technique of the larger variance; −1: undecided
mis_gain | f | 1 | y x | variance of the better single strategy / variance of MIS
predicted_ratio | f | 1 | strategy y x | predicted / measured variance at the largest n
path_variance | f | f² | y x | variance of one random path
bounce_share | f | 1 | bounce y x | \
what a bounce adds to the variance that the bounces before it make / variance
decision_share | f | 1 | decision y x | \
sum over bounces of what a decision adds to the variance that those before it make / variance
largest_bounce | f | 1 | y x | number of the bounce of the largest share; −1: undecided
largest_decision | f | 1 | y x | number of the decision of the largest share; −1: undecided
best_sampler | f | 1 | strategy y x | number of the sampler of the least variance; −1: no difference
measured | f | 1 | y x | whether the pixel is measured (1: yes) or interpolated (0)
interpolation_factor | f | 1 | strategy y x | \
factor by which 95 % of the variances differ at most from the interpolated ones
wraparound_discrepancy | f | 1 | any | wrap-around L2 discrepancy
relative_rmse | f | 1 | n y x | σ / mean of one frame
largest_share | f | 1 | n y x | \
share of the frame that is farthest from the mean in the sum of squares
picture_variance | f | f² | n | mean over the pixels of the variance of one frame
picture_rate | f | 1 | | exponent of the mean variance in samples a pixel
needed_spp | f | 1 | y x | samples a pixel at which the wanted σ / mean is reached
error_spectrum | f | 1 | n radius | power of the standardized errors of a frame; white noise: 1
error_correlation | f | 1 | n lag_y lag_x | correlation of the errors of pixels at a distance
joint_spectrum | f | 1 | n radius frame_frequency | \
power of the standardized errors by radial and temporal frequency; white noise: 1
frame_correlation | f | 1 | n lag_t | correlation of the errors of frames of a sequence at a lag
boiling | f | 1 | n | power of errors below 1/8 cycle per frame; white noise: 1
effective_frames | f | 1 | n | independent frames whose mean has the variance of a sequence's mean
pixel_effective_frames | f | 1 | n y x | the same number for each pixel
filtered_variance | f | f² | n filter | mean over the pixels of the variance after a filter
filtered_ratio | f | 1 | n filter | \
variance after a filter / the same of white noise of the same variance
filtered_picture_ratio | f | 1 | filter | filtered variance / that of the other frames
gaussian_variance | f | f² | n sigma | variance after a Gaussian filter of σ pixels
gaussian_ratio | f | 1 | n sigma | that variance / the same of white noise of the same variance
gaussian_picture_ratio | f | 1 | sigma | that variance / that of the other frames
average_variance | f | f² | n alpha | variance after an exponential moving average of weight α
average_ratio | f | 1 | n alpha | that variance / the same of white noise of the same variance
denoised_variance | f | f² | | variance after a program, mean over the pixels
denoised_square | f | f² | | squared bias of a program, mean over the pixels
denoised_boiling | f | 1 | | power of errors below 1/8 cycle per frame after a program; white: 1
denoised_correlation | f | 1 | lag_t | correlation of errors at a lag after a program
bias_z | f | 1 | y x | mean minus reference over its standard error, as a normal deviate
squared_bias | f | f² | n | mean over the pixels of the squared bias against the reference
tile_bias | f | 1 | n tile_y tile_x | mean error / mean of the reference
tile_relmse | f | 1 | n tile_y tile_x | mean of (x − r)² / (r² + 0.01) against the reference r
tile_smape | f | 1 | n tile_y tile_x | mean of |x − r| / (|x| + |r| + 0.01)
tile_flip | f | 1 | n tile_y tile_x | mean FLIP of one frame against the reference
frame_bias | f | 1 | n frame | mean error of a frame of the sequences / mean of its reference
frame_relmse | f | 1 | n frame | relMSE of a frame of the sequences against its reference
frame_smape | f | 1 | n frame | SMAPE of a frame of the sequences against its reference
image_bias | f | 1 | n | mean error of the image / mean of the reference
image_relmse | f | 1 | n | relMSE of the image against the reference
image_smape | f | 1 | n | SMAPE of the image against the reference
average_picture_ratio | f | 1 | alpha | that variance / that of the other frames
flip | f | 1 | n y x | FLIP of one frame against the mean
error_power | f | f² | frequency radius | \
power of the errors of pixels; white noise: mean squared error of a pixel
relative_power | f | 1 | frequency radius | \
power of the errors of pixels / mean squared error of a pixel; white noise: 1
pixel_error | f | f² | | mean squared error of a pixel
slow_share | f | 1 | | power of errors at low frequencies in time / its mean; white noise: 1
filtered_error | f | f² | filter | mean squared error of a pixel after a filter
filtered_ratio | f | 1 | filter | mean squared error after a filter / that of random points
best | i | 1 | filter | number of the sampler of the least error; −1: undecided
error_image | f | f | y x | errors of the pixels of one frame
error_slice | f | f | frame x | errors of one row of pixels over the frames
blocks | i | 1 | | independent blocks of pixels and frames
predicted_power | f | f² | radius | \
power of an image of errors, from spectra; white noise: the variance
measured_power | f | f² | radius | power of an image of errors
low_share | f | 1 | | power of errors at low frequencies between pixels / its mean; white noise: 1
difference | f | f | y x | mean minus that of the other frames
difference_z | f | 1 | y x | that difference over its standard error, as a normal deviate (Welch)
single_p | f | 1 | y x | p-value of the difference of a tile alone
smallest_p | f | 1 | y x | smallest p-value of the tiles around a point, corrected for all tests
p_share | f | 1 | bin | share of the tiles with a p-value in the bin
test_p | f | 1 | test | p-value of a test, corrected for all tests
test_statistic | f | 1 | test | largest difference in standard errors, or t value
test_size | i | 1 | test | width of the tiles in pixels; 0: the image
detectable | f | 1 | test | relative bias that the test finds with 90 % probability
picture_ratio | f | 1 | | mean variance / that of the other frames
equal_time_ratio | f | 1 | | mean variance × time / that of the other frames
selection_ratio | f | 1 | | variance of random paths with lights chosen by second moments / as given
value | f | f | | integral, mean over the replicates
interval | f | f | bound | 95 % interval: integral
replicates | i | 1 | | independent point sets
skipped | i | 1 | | evaluations that failed and were left out
n | i | 1 | | points of each set
mean_variance | f | f² | | variance, mean over a class of integrands
design_ratio | f | 1 | | mean variance of the designed sampler / that of the best rival
"""

_VARIABLES: dict[str, Variable] = {}
for _row in _TABLE.splitlines()[1:]:
    _name, _kind, _unit, _dims, _meaning = map(str.strip, _row.split("|", 4))
    _known = None if _dims == "any" else tuple(_dims.split())
    _VARIABLES[_name] = Variable(_meaning, _unit, _known, _kind)

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
"""Variables by name. Names in ``_se`` are standard errors, and names in ``_ci`` are intervals."""


def dataset(
    variables: Mapping[str, tuple[tuple[str, ...], Any]],
    coords: Mapping[str, Any] | None = None,
    *,
    drop: Collection[str] = (),
    **provenance: Any,
) -> xr.Dataset:
    """Make a dataset of registered variables, name -> (dims, values), and provenance attributes.

    Dims in `drop` have a single value, such as the channel of a scalar, and are removed.
    """
    import xarray as xr

    register_accessor()
    arrays = {}
    for name, (dims, values) in variables.items():
        if any(dim in drop for dim in dims):
            values = values[tuple(0 if dim in drop else slice(None) for dim in dims)]
        about = {"long_name": VARIABLES[name].meaning, "units": VARIABLES[name].units}
        arrays[name] = (tuple(dim for dim in dims if dim not in drop), values, about)

    attributes = {**attributes_of(**provenance), **package_versions()}
    return xr.Dataset(arrays, coords=coords, attrs=attributes)


def coordinate(dim: str, values: Any, meaning: str) -> tuple[str, Any, dict[str, str]]:
    """Return a coordinate of a dataset. Its values are numbers without a unit."""
    return dim, values, {"long_name": meaning, "units": "1"}


def attributes_of(**provenance: Any) -> dict[str, str | int | float]:
    """Convert attributes to types that every storage format supports. Drop attributes of None.

    The storable types are 64-bit numbers, strings and JSON text.
    """
    attributes = {}
    for key, value in provenance.items():
        plain = value.item() if isinstance(value, np.generic) else value
        if plain is not None:
            fits = (
                plain.bit_length() < 64
                if isinstance(plain, int)
                else isinstance(plain, str | float)
            )
            attributes[key] = plain if fits else json.dumps(plain)
    return attributes


def strict_json(value: Any) -> Any:
    """Convert a value to strict JSON: arrays to lists, NaN to null, paths and ``inf`` to text."""
    if isinstance(value, Mapping):
        return {str(key): strict_json(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [strict_json(item) for item in value]
    if isinstance(value, np.ndarray | np.generic):
        return strict_json(value.tolist())
    if isinstance(value, complex):
        return {"re": strict_json(value.real), "im": strict_json(value.imag)}
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else str(value)
    return str(value) if isinstance(value, Path) else value


def check_variables(result: xr.Dataset, declared: Sequence[str | Variable], analysis: str) -> None:
    """Check a result against the variables that its analysis declares.

    Raises
    ------
    AnalysisError
        If a variable is not declared, or has other dims or another type of numbers.
    """
    known = {v if isinstance(v, str) else v.name: v for v in declared}
    for name, values in result.data_vars.items():
        about = known.get(str(name))
        if about is None:
            raise AnalysisError(
                f"{analysis} gives the variable {shown(name)}, which it does not declare."
            )
        about = VARIABLES[about] if isinstance(about, str) else about
        if values.dtype.kind not in about.kind:
            raise AnalysisError(
                f"{analysis}: {name} holds {values.dtype}, but {shown(about.kind)} is declared."
            )
        # Compare the dims with the declared ones: m means m0, m1, …, and dims with ? are optional
        found = [str(d) for d in values.dims if d not in _FREE_DIMS or d in (about.dims or ())]
        pattern = ""
        for dim in about.dims or ():
            named = f"({re.escape(dim.removesuffix('?'))} )" + "?" * dim.endswith("?")
            pattern += r"(m\d* )*" if dim == "m" else named
        if about.dims is not None and not re.fullmatch(
            pattern, "".join(f"{dim} " for dim in found)
        ):
            raise AnalysisError(
                f"{analysis}: {name} has the dims {found}, but {about.dims} are declared."
            )


@functools.cache
def package_versions() -> dict[str, str]:
    """Return the versions of this package and of all packages that affect its numbers."""
    found = {}
    for name in ("mcspectra", "numpy", "scipy", "numba", "finufft"):
        try:
            found[f"version_{name}"] = version(name)
        except PackageNotFoundError:
            found[f"version_{name}"] = "unknown"
    return found
