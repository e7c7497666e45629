"""Point sets: samplers, randomizations that wrap them, and sets from outside."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
