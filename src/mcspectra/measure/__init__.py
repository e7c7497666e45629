"""Measurements of the variance against n, term by term, and by technique, axis and mode."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
