"""Plots: functions turn a result into a description (`Plot`), and a backend draws it.

There are two backends. Matplotlib draws files, notebooks and the accessor ``.mcspectra.plot()``.
Bokeh draws reports and the explorer. The description is independent of the backend.
"""
