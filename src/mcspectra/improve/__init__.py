"""What lowers the variance: changes to an estimator or a sampler, compared side by side, and designs."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
