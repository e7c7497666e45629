"""Convert mathematics to MathML. Browsers draw it in a font that is stored with the pages.

Large brackets and roots need a font with mathematical tables.
"""

import shutil
from html import escape
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

from docutils import nodes
from latex2mathml.converter import convert
from sphinx.application import Sphinx
from sphinx.util.math import get_node_equation_number

__all__ = ["mathml", "setup"]

_FONT = "STIXTwoMath-Regular.ttf"  # its license is the SIL Open Font License
_BAR = "\u2015"
_NAMESPACE = "http://www.w3.org/1998/Math/MathML"


def mathml(latex: str, display: str = "inline") -> str:
    """Convert a formula to MathML.

    An overline becomes a border, which is as wide as the formula below it in any font.
    No space is put next to the bars of |x|, because opening and closing bars are the same sign.

    Raises
    ------
    ValueError
        If the converter does not support a LaTeX command.
    """
    ET.register_namespace("", _NAMESPACE)
    root = ET.fromstring(convert(latex, display=display))
    for over in root.iter(f"{{{_NAMESPACE}}}mover"):
        if over[-1].text == _BAR:
            over.tag = f"{{{_NAMESPACE}}}mrow"
            over.set("class", "overline")
            over.remove(over[-1])
    for sign in root.iter(f"{{{_NAMESPACE}}}mo"):
        if sign.text == "|" and "form" not in sign.attrib:
            sign.set("lspace", "0")
            sign.set("rspace", "0")
    unknown = [text for text in root.itertext() if "\\" in text]
    if unknown:
        message = f"{unknown[0]} in {latex!r} has no MathML."
        raise ValueError(message)
    return ET.tostring(root, encoding="unicode")


def _inline(translator: Any, node: nodes.math) -> None:
    translator.body.append(mathml(node.astext()))
    raise nodes.SkipNode


def _display(translator: Any, node: nodes.math_block) -> None:
    translator.body.append(translator.starttag(node, "div", CLASS="math notranslate"))
    if node["number"]:
        number = escape(get_node_equation_number(translator, node))
        translator.body.append(f'<span class="eqno">({number})')
        translator.add_permalink_ref(node, "Link to this equation")
        translator.body.append("</span>")
    translator.body.append(mathml(node.astext(), "block"))
    translator.body.append("</div>")
    raise nodes.SkipNode


def _bring_font(app: Sphinx, failure: Exception | None) -> None:
    if failure is None and app.builder.format == "html":
        with as_file(files("ziamath") / "fonts" / _FONT) as font:
            shutil.copyfile(font, Path(app.outdir) / "_static" / _FONT)


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the renderer under the name ``mathml``."""
    app.add_html_math_renderer("mathml", (_inline, None), (_display, None))
    app.connect("build-finished", _bring_font)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
