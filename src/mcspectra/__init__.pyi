from . import densities as densities
from . import estimators as estimators
from . import explain as explain
from . import improve as improve
from . import integrands as integrands
from . import measure as measure
from . import prediction as prediction
from . import profiler as profiler
from . import quality as quality
from . import rendering as rendering
from . import report as report
from . import samplers as samplers
from . import spectra as spectra
from . import studies as studies
from .core.errors import McspectraError as McspectraError
from .core.errors import NoClosedForm as NoClosedForm
from .core.progress import progress_bars as progress_bars
from .densities.base import Density as Density
from .densities.registry import density as density
from .estimators.importance import Estimator as Estimator
from .estimators.mirrored import Mirrored as Mirrored
from .estimators.mis import MultipleImportance as MultipleImportance
from .explain.causes import Cause as Cause
from .improve.alignment import aligned as aligned
from .improve.designs.design import certificate as certificate
from .improve.designs.design import design as design
from .improve.planning import plan as plan
from .improve.remedy import remedies as remedies
from .integrands.base import Integrand as Integrand
from .integrands.registry import integrand as integrand
from .integrands.smoothing import smoothed as smoothed
from .measure.anova import anova_variances as anova_variances
from .measure.bench import sampler_bench as sampler_bench
from .measure.converge import convergence as convergence
from .measure.integration import integrate as integrate
from .measure.modes import covariance_modes as covariance_modes
from .measure.techniques import technique_terms as technique_terms
from .measure.terms import variance_terms as variance_terms
from .prediction.exact import exact_variance as exact_variance
from .prediction.prediction import predict as predict
from .profiler.profiling import Profile as Profile
from .profiler.profiling import profile as profile
from .quality.figures import quality_figures as quality_figures
from .samplers.base import Sampler as Sampler
from .samplers.registry import sampler as sampler
from .spectra.closed_forms import closed_form_power as closed_form_power
from .spectra.pairs import pair_correlation as pair_correlation
from .spectra.power import power_spectrum as power_spectrum
from .version import __version__ as __version__

__all__ = [
    "Cause",
    "Density",
    "Estimator",
    "Integrand",
    "McspectraError",
    "Mirrored",
    "MultipleImportance",
    "NoClosedForm",
    "Profile",
    "Sampler",
    "__version__",
    "aligned",
    "anova_variances",
    "certificate",
    "closed_form_power",
    "convergence",
    "covariance_modes",
    "densities",
    "density",
    "design",
    "estimators",
    "exact_variance",
    "explain",
    "improve",
    "integrand",
    "integrands",
    "integrate",
    "measure",
    "pair_correlation",
    "plan",
    "power_spectrum",
    "predict",
    "prediction",
    "profile",
    "profiler",
    "progress_bars",
    "quality",
    "quality_figures",
    "remedies",
    "rendering",
    "report",
    "sampler",
    "sampler_bench",
    "samplers",
    "smoothed",
    "spectra",
    "studies",
    "technique_terms",
    "variance_terms",
]
