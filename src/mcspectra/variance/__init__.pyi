from .alignment import aligned as aligned
from .alignment import best_alignment as best_alignment
from .alignment import strata_shift_scan as strata_shift_scan
from .anova import anova_spectrum as anova_spectrum
from .anova import anova_variances as anova_variances
from .bench import sampler_bench as sampler_bench
from .chains import chain_error as chain_error
from .designs.design import certificate as certificate
from .designs.design import design as design
from .exact import exact_variance as exact_variance
from .image_errors import image_error_spectrum as image_error_spectrum
from .integration import integrate as integrate
from .learned import learned_density as learned_density
from .measured import convergence as convergence
from .measured import realizations_needed as realizations_needed
from .modes import covariance_modes as covariance_modes
from .prediction.plan import plan as plan
from .prediction.predict import predict as predict
from .prediction.rates import DecayFit as DecayFit
from .prediction.rates import fitted_decay as fitted_decay
from .prediction.rates import integrand_decay as integrand_decay
from .prediction.rates import predicted_rate as predicted_rate
from .primary import primary_picture as primary_picture
from .profiling.causes import Cause as Cause
from .profiling.profile import Profile as Profile
from .profiling.profile import profile as profile
from .remedy import remedies as remedies
from .techniques import technique_terms as technique_terms
from .terms import variance_terms as variance_terms
from .variants import mirror_study as mirror_study
from .variants import smoothing_scan as smoothing_scan

__all__ = [
    "Cause",
    "DecayFit",
    "Profile",
    "aligned",
    "anova_spectrum",
    "anova_variances",
    "best_alignment",
    "certificate",
    "chain_error",
    "convergence",
    "covariance_modes",
    "design",
    "exact_variance",
    "fitted_decay",
    "image_error_spectrum",
    "integrand_decay",
    "integrate",
    "learned_density",
    "mirror_study",
    "plan",
    "predict",
    "predicted_rate",
    "primary_picture",
    "profile",
    "realizations_needed",
    "remedies",
    "sampler_bench",
    "smoothing_scan",
    "strata_shift_scan",
    "technique_terms",
    "variance_terms",
]
