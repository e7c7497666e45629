"""Predictions of the variance from the law of a sampler and facts about an integrand."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
