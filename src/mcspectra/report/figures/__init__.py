"""Figures of results: each takes datasets by sampler and returns a matplotlib figure.

They use matplotlib's object interface only: a notebook shows the figure that is returned, and
nothing global changes.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
