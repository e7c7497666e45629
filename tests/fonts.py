"""Fonts of PDF files, made once for all files."""

from contextlib import contextmanager
from functools import cache
from types import SimpleNamespace

import pytest

# Latin, Greek, superscripts and mathematics: the characters of figures
_CHARACTERS = (*range(0x20, 0x180), *range(0x370, 0x400), *range(0x2000, 0x22FF))


@pytest.fixture(scope="module", autouse=True)
def fonts_once():
    """Embed one part of a font into all PDF files, instead of a part of its own in each file.

    Matplotlib cuts a font for each file, which takes longer than drawing the figure.
    Here a file has more glyphs than it needs, and everything else is the same.
    The tests in `plots` embed the usual fonts.
    """
    from matplotlib.backends import _backend_pdf_ps

    usual = _backend_pdf_ps.get_glyphs_subset

    @contextmanager
    def kept(file, glyphs):
        content, places = _part(usual, file)
        if not places.keys() >= set(glyphs):
            with usual(file, glyphs) as made:
                yield made
            return
        font = SimpleNamespace(save=lambda out, **_: out.write(content))
        yield SimpleNamespace(font=font, glyph_index_map=places)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(_backend_pdf_ps, "get_glyphs_subset", kept)
        yield


@cache
def _part(usual, file):
    """Return the bytes of a font with all characters of figures, and the places of its glyphs."""
    from matplotlib.backends._backend_pdf_ps import font_as_file
    from matplotlib.ft2font import FT2Font

    font = FT2Font(file)
    with usual(file, {font.get_char_index(each) for each in _CHARACTERS}) as made:
        return font_as_file(made.font).getvalue(), dict(made.glyph_index_map)
