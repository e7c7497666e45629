"""What holds of every exhibit."""

import pytest

from mcspectra.plots import backend_bokeh, backend_matplotlib


@pytest.fixture(scope="session", name="sound")
def _sound():
    """Check that all claims hold, every text is there, and both backends draw every plot."""

    def check(made):
        assert [f.statement for f in made.findings if f.agrees is not True] == []
        assert len(made.caption) > 100
        for plot in made.plots:
            assert len(plot.words) > 40
            assert len(plot.caption) > 40
            backend_bokeh.draw(plot)
            backend_matplotlib.draw(plot)

    return check
