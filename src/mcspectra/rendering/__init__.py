"""Rendering: an interface to Mitsuba 3 that treats the radiance of a pixel as an integrand."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
