"""mcspectra: a profiler for Monte Carlo noise.

An estimator has an integrand, one or several importance densities, and a sampler.
The package measures the variance and the convergence rate of an estimator,
predicts variance and rate from spectra, and explains them.
All names below load their modules when first used.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
