"""What tests of plots look at."""

from bokeh.core.serialization import Serializer

from mcspectra.plots import backend_bokeh, backend_matplotlib


def marks(plot, kind):
    """Marks of a kind, over all panels."""
    return [m for panel in plot.panels for m in panel.marks if isinstance(m, kind)]


def drawn_by_both(plot):
    """Draw with either backend; the models of bokeh can be written."""
    backend_matplotlib.draw(plot).canvas.draw()
    Serializer().encode(backend_bokeh.draw(plot).model)
