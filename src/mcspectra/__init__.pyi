from . import densities as densities
from . import estimators as estimators
from . import integrands as integrands
from . import quality as quality
from . import rendering as rendering
from . import report as report
from . import samplers as samplers
from . import spectra as spectra
from . import studies as studies
from . import variance as variance
from .core.errors import McspectraError as McspectraError
from .core.errors import NoClosedForm as NoClosedForm
from .core.progress import progress_bars as progress_bars
from .densities.base import Density as Density
from .densities.registry import density as density
from .estimators.channels import ChannelSampling as ChannelSampling
from .estimators.channels import channel_estimators as channel_estimators
from .estimators.importance import Estimator as Estimator
from .estimators.mirrored import Mirrored as Mirrored
from .estimators.mis import MultipleImportance as MultipleImportance
from .estimators.mis import OneSampleMIS as OneSampleMIS
from .estimators.mis import TechniqueSum as TechniqueSum
from .integrands.base import Integrand as Integrand
from .integrands.registry import integrand as integrand
from .integrands.smoothing import smoothed as smoothed
from .quality.figures import quality_figures as quality_figures
from .quality.warps import warp_quality as warp_quality
from .samplers.base import Randomization as Randomization
from .samplers.base import Sampler as Sampler
from .samplers.registry import sampler as sampler
from .spectra.closed_forms import closed_form_covariance as closed_form_covariance
from .spectra.closed_forms import closed_form_power as closed_form_power
from .spectra.gain import closed_form_walsh_power as closed_form_walsh_power
from .spectra.gain import gain_coefficients as gain_coefficients
from .spectra.gain import nested_variances as nested_variances
from .spectra.listed import axis_frequencies as axis_frequencies
from .spectra.listed import diagonal_frequencies as diagonal_frequencies
from .spectra.listed import plane_frequencies as plane_frequencies
from .spectra.listed import power_at as power_at
from .spectra.listed import subset_frequencies as subset_frequencies
from .spectra.pair_correlation import (
    closed_form_pair_correlation as closed_form_pair_correlation,
)
from .spectra.pair_correlation import pair_correlation as pair_correlation
from .spectra.power import power_spectrum as power_spectrum
from .spectra.shapes import low_frequency_exponent as low_frequency_exponent
from .spectra.shapes import radial_statistics as radial_statistics
from .spectra.shapes import slices as slices
from .spectra.shapes import variance_from_spectrum as variance_from_spectrum
from .spectra.shapes import wedge_means as wedge_means
from .variance.alignment import aligned as aligned
from .variance.alignment import best_alignment as best_alignment
from .variance.alignment import strata_shift_scan as strata_shift_scan
from .variance.anova import anova_spectrum as anova_spectrum
from .variance.anova import anova_variances as anova_variances
from .variance.bench import sampler_bench as sampler_bench
from .variance.chains import chain_error as chain_error
from .variance.convergence import convergence as convergence
from .variance.convergence import realizations_needed as realizations_needed
from .variance.design.design import certificate as certificate
from .variance.design.design import design as design
from .variance.exact import exact_variance as exact_variance
from .variance.image_errors import image_error_spectrum as image_error_spectrum
from .variance.integrate import integrate as integrate
from .variance.learned import learned_density as learned_density
from .variance.modes import covariance_modes as covariance_modes
from .variance.prediction.plan import plan as plan
from .variance.prediction.predict import predict as predict
from .variance.prediction.rates import DecayFit as DecayFit
from .variance.prediction.rates import fitted_decay as fitted_decay
from .variance.prediction.rates import integrand_decay as integrand_decay
from .variance.prediction.rates import predicted_rate as predicted_rate
from .variance.primary import primary_picture as primary_picture
from .variance.profiling.causes import Cause as Cause
from .variance.profiling.profile import Profile as Profile
from .variance.profiling.profile import profile as profile
from .variance.remedies import remedies as remedies
from .variance.techniques import technique_terms as technique_terms
from .variance.terms import variance_terms as variance_terms
from .variance.variants import mirror_study as mirror_study
from .variance.variants import smoothing_scan as smoothing_scan
from .version import __version__ as __version__

__all__ = [
    "Cause",
    "ChannelSampling",
    "DecayFit",
    "Density",
    "Estimator",
    "Integrand",
    "McspectraError",
    "Mirrored",
    "MultipleImportance",
    "NoClosedForm",
    "OneSampleMIS",
    "Profile",
    "Randomization",
    "Sampler",
    "TechniqueSum",
    "__version__",
    "aligned",
    "anova_spectrum",
    "anova_variances",
    "axis_frequencies",
    "best_alignment",
    "certificate",
    "chain_error",
    "channel_estimators",
    "closed_form_covariance",
    "closed_form_pair_correlation",
    "closed_form_power",
    "closed_form_walsh_power",
    "convergence",
    "covariance_modes",
    "densities",
    "density",
    "design",
    "diagonal_frequencies",
    "estimators",
    "exact_variance",
    "fitted_decay",
    "gain_coefficients",
    "image_error_spectrum",
    "integrand",
    "integrand_decay",
    "integrands",
    "integrate",
    "learned_density",
    "low_frequency_exponent",
    "mirror_study",
    "nested_variances",
    "pair_correlation",
    "plan",
    "plane_frequencies",
    "power_at",
    "power_spectrum",
    "predict",
    "predicted_rate",
    "primary_picture",
    "profile",
    "progress_bars",
    "quality",
    "quality_figures",
    "radial_statistics",
    "realizations_needed",
    "remedies",
    "rendering",
    "report",
    "sampler",
    "sampler_bench",
    "samplers",
    "slices",
    "smoothed",
    "smoothing_scan",
    "spectra",
    "strata_shift_scan",
    "studies",
    "subset_frequencies",
    "technique_terms",
    "variance",
    "variance_from_spectrum",
    "variance_terms",
    "warp_quality",
    "wedge_means",
]
