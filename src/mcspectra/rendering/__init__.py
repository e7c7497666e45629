"""Rendering: the bridge to Mitsuba 3, where a pixel is one more integrand."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
