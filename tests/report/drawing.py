"""Figures of pages left out, or drawn in less time; loads neither Bokeh nor Matplotlib itself."""

from contextlib import contextmanager

import pytest
from tests.report.figures import leave_out_figures


@pytest.fixture
def undrawn(monkeypatch):
    """Leave out figures of pages, for tests of other contents."""
    leave_out_figures(monkeypatch.setattr)


@contextmanager
def no_layout():
    """Draw figures without layout, which takes half of the time of a picture."""
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ConstrainedLayoutEngine, "execute", lambda *_: None)
        yield


@contextmanager
def no_pdf():
    """Write PDF files without contents, which take half of the time of a figure; omit layout."""
    from mcspectra.plots import backend_matplotlib

    usual = backend_matplotlib.rasterize

    def rasterize(figure, *, with_pdf, **options):
        return usual(figure, with_pdf=False, **options)[0], b" " if with_pdf else b""

    with no_layout(), pytest.MonkeyPatch.context() as patch:
        patch.setattr(backend_matplotlib, "rasterize", rasterize)
        yield
