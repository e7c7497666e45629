"""mcspectra: a profiler for Monte Carlo noise.

Give it an estimator (an integrand, an importance density or several, a sampler); it measures the
variance and its convergence rate, predicts them from spectra, and explains them. All names below
load their modules when first used.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
