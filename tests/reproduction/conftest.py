"""What holds of every exhibit."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from mcspectra.plots import backend_bokeh, backend_matplotlib
from mcspectra.reproduction.claims import Exhibit


@pytest.fixture(scope="session", name="sound")
def _sound() -> Callable[[Exhibit], None]:
    """Check that all claims hold, every text is there, and both backends draw every plot."""

    def check(made: Exhibit) -> None:
        assert [f.statement for f in made.findings if f.agrees is not True] == []
        assert len(made.caption) > 100
        for plot in made.plots:
            assert len(plot.words) > 40
            assert len(plot.caption) > 40
            backend_bokeh.draw(plot)
            backend_matplotlib.draw(plot)

    return check
