from .exact import exact_variance as exact_variance
from .image_errors import image_error_spectrum as image_error_spectrum
from .prediction import predict as predict
from .rates import DecayFit as DecayFit
from .rates import fitted_decay as fitted_decay
from .rates import integrand_decay as integrand_decay
from .rates import predicted_rate as predicted_rate

__all__ = [
    "DecayFit",
    "exact_variance",
    "fitted_decay",
    "image_error_spectrum",
    "integrand_decay",
    "predict",
    "predicted_rate",
]
