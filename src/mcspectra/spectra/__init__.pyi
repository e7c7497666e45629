from .closed_forms import closed_form_covariance as closed_form_covariance
from .closed_forms import closed_form_power as closed_form_power
from .gain import closed_form_walsh_power as closed_form_walsh_power
from .gain import gain_coefficients as gain_coefficients
from .gain import nested_variances as nested_variances
from .listed import axis_frequencies as axis_frequencies
from .listed import diagonal_frequencies as diagonal_frequencies
from .listed import plane_frequencies as plane_frequencies
from .listed import power_at as power_at
from .listed import subset_frequencies as subset_frequencies
from .pairs import closed_form_pair_correlation as closed_form_pair_correlation
from .pairs import pair_correlation as pair_correlation
from .power import power_spectrum as power_spectrum
from .shapes import low_frequency_exponent as low_frequency_exponent
from .shapes import radial_statistics as radial_statistics
from .shapes import slices as slices
from .shapes import variance_from_spectrum as variance_from_spectrum
from .shapes import wedge_means as wedge_means

__all__ = [
    "axis_frequencies",
    "closed_form_covariance",
    "closed_form_pair_correlation",
    "closed_form_power",
    "closed_form_walsh_power",
    "diagonal_frequencies",
    "gain_coefficients",
    "low_frequency_exponent",
    "nested_variances",
    "pair_correlation",
    "plane_frequencies",
    "power_at",
    "power_spectrum",
    "radial_statistics",
    "slices",
    "subset_frequencies",
    "variance_from_spectrum",
    "wedge_means",
]
