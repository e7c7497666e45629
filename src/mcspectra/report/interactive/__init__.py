"""Figures to look into: bokeh plots with exact values under the pointer and lines that hide.

They take what `mcspectra.report.figures` takes, load nothing from a network, and are readable on
light and dark pages alike.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
