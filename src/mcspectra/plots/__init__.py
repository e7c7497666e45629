"""Plots: a result becomes a description (`Plot`), which one of two backends draws.

matplotlib draws files, notebooks and the accessor ``.mcspectra.plot()``; bokeh draws reports and the
explorer. A figure is described once: what it shows does not depend on what draws it.
"""
