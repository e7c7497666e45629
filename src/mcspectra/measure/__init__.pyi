from .anova import anova_spectrum as anova_spectrum
from .anova import anova_variances as anova_variances
from .bench import sampler_bench as sampler_bench
from .chains import chain_error as chain_error
from .converge import convergence as convergence
from .converge import realizations_needed as realizations_needed
from .integration import integrate as integrate
from .modes import covariance_modes as covariance_modes
from .techniques import technique_terms as technique_terms
from .terms import variance_terms as variance_terms

__all__ = [
    "anova_spectrum",
    "anova_variances",
    "chain_error",
    "convergence",
    "covariance_modes",
    "integrate",
    "realizations_needed",
    "sampler_bench",
    "technique_terms",
    "variance_terms",
]
