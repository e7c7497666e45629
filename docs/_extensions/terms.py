"""Link each term of the glossary where it first appears on a page.

The directive ``glossary`` in conventions.md lists the terms. Pages need no markup for them.
"""

import re
from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx import addnodes
from sphinx.application import Sphinx

__all__ = ["glossary_terms", "link_terms", "setup"]

_PAGE = "conventions"
# Terms that are not linked: everyday words and single letters
_UNLINKED = {
    "f", "p", "g", "law", "method", "answer", "candidate", "cell", "task", "study", "cause",
    "remedy", "analysis", "contribution", "captured", "net", "rate", "spec", "density",
    "integrand", "estimator", "technique", "replicate",
}  # fmt: skip
_NOT_IN = (
    nodes.title, nodes.literal, nodes.reference, nodes.literal_block, nodes.math, nodes.caption,
    nodes.citation, nodes.footnote, nodes.image, nodes.term, addnodes.pending_xref, addnodes.desc,
)  # fmt: skip


def glossary_terms(text: str) -> list[str]:
    """Return the terms of the glossary in a page's Markdown."""
    (block,) = re.findall(r"^```\{glossary\}\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    return [line.strip() for line in block.splitlines() if line.strip() and line[0] != " "]


def link_terms(document: nodes.Node, terms: list[str]) -> None:
    """Replace the first mention of each term in running text by a link to its entry."""
    left = {term.lower(): term for term in terms if term not in _UNLINKED}
    for text in list(document.findall(nodes.Text)):
        if not left:
            return
        if _is_running_text(text):
            parts = _with_links(text.astext(), left)
            if len(parts) > 1:
                text.parent.replace(text, parts)


def _is_running_text(text: nodes.Text) -> bool:
    node, in_paragraph = text.parent, False
    while node is not None:
        if isinstance(node, _NOT_IN):
            return False
        in_paragraph |= isinstance(node, nodes.paragraph)
        node = node.parent
    return in_paragraph


def _with_links(text: str, left: dict[str, str]) -> list[nodes.Node]:
    """Link the terms of ``left`` that occur in a text, and remove these terms from ``left``."""
    parts: list[nodes.Node] = []
    while left:
        names = sorted(map(_pattern, left.values()), key=len, reverse=True)
        match = re.search(rf"(?<![\w-])({'|'.join(names)})s?(?![\w-])", text)
        if match is None:
            break
        link = addnodes.pending_xref(
            "",
            nodes.inline("", match[0], classes=["std", "std-term"]),
            refdomain="std",
            reftype="term",
            reftarget=left.pop(match[1].lower()),
            refexplicit=True,
            refwarn=True,
        )
        parts += [nodes.Text(text[: match.start()]), link]
        text = text[match.end() :]
    return [*parts, nodes.Text(text)]


def _pattern(term: str) -> str:
    """Return a regular expression for a term. It ignores case, except for abbreviations."""
    return re.escape(term) if term.isupper() else f"(?i:{re.escape(term)})"


def _link(app: Sphinx, document: nodes.document) -> None:
    page = Path(app.srcdir) / f"{_PAGE}.md"
    app.env.note_dependency(str(page))
    if app.env.docname not in (_PAGE, "references") and not app.env.docname.startswith("api/"):
        link_terms(document, glossary_terms(page.read_text(encoding="utf-8")))


def setup(app: Sphinx) -> dict[str, Any]:
    """Link terms after a page is read, and before its links are resolved."""
    app.connect("doctree-read", _link)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
