"""Rendering: the interface to Mitsuba 3, in which the radiance of a pixel is an integrand."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
