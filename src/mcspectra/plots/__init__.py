"""Plots: functions turn a result into a description (`Plot`), and one of two backends draws it.

Matplotlib draws files, notebooks and the accessor ``.mcspectra.plot()``.
Bokeh draws reports and the explorer. The description is independent of the backend.
"""
