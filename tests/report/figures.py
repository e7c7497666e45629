"""Pages without their figures; programs of tests also load this module, so it imports little."""

import contextlib

from mcspectra.report import page


def leave_out_figures(patch):
    """Replace figures of pages by their words; `patch` sets an attribute, as ``setattr`` does."""
    patch(page, "_images", lambda *_, **__: None)
    patch(page, "_embedded", _words_alone)


@contextlib.contextmanager
def without_figures():
    """Leave out figures in this context."""
    before = page._images, page._embedded
    leave_out_figures(setattr)
    try:
        yield
    finally:
        page._images, page._embedded = before


def _words_alone(figure, *_):
    """Return a figure for the template without an image."""
    plot = figure.plot
    blank = {**dict.fromkeys(("png", "thumbnail", "file", "live"), ""), "width": 1, "height": 1}
    said = {"words": plot.words, "caption": plot.caption}
    return blank | said | {"wide": plot.wide, "abreast": False, "frames": {}}
