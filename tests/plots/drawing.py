"""Helpers for tests of plots."""

from mcspectra.plots import backend_matplotlib


def marks(plot, kind):
    """Return the marks of a class in all panels."""
    return [m for panel in plot.panels for m in panel.marks if isinstance(m, kind)]


def drawn_by_both(plot):
    """Draw with both backends, and check that the Bokeh models can be written."""
    backend_matplotlib.draw(plot).canvas.draw()
    written_by_bokeh(plot)


def written_by_bokeh(plot):
    """Draw with Bokeh, and check that the models can be written."""
    from bokeh.core.serialization import Serializer

    from mcspectra.plots import backend_bokeh

    Serializer().encode(backend_bokeh.draw(plot).model)
