"""Changes of an estimator or a sampler that lower the variance: comparisons and designs."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
