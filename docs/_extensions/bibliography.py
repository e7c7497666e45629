"""The directive ``bibliography`` for a page of all works, and the role ``cite``.

Docstrings cite a work as [Key]_. Markdown pages cite a work as {cite}`Key`.
"""

from typing import Any

from docutils import nodes
from docutils.parsers.rst import Directive
from sphinx.application import Sphinx

from mcspectra.core.references import FILE, address, works

__all__ = ["setup"]


def _authors(text: str) -> str:
    names = [" ".join(reversed(name.split(", ", 1))) for name in text.split(" and ")]
    return ", ".join(names)


def _citation(key: str, fields: dict[str, str]) -> nodes.citation:
    parts = [fields.get(name) for name in ("journal", "booktitle", "publisher", "school", "note")]
    place = next((part for part in parts if part), None)
    paragraph = nodes.paragraph("", f"{_authors(fields.get('author', ''))}: ")
    paragraph += nodes.emphasis("", fields.get("title", key))
    tail = [part for part in (place, fields.get("year")) if part]
    paragraph += nodes.Text("".join(f", {part}" for part in tail) + ".")
    if where := address(fields):
        paragraph += [nodes.Text(" "), nodes.reference("", where, refuri=where), nodes.Text(".")]
    return nodes.citation("", nodes.label("", key), paragraph)


class _Bibliography(Directive):
    def run(self) -> list[nodes.Node]:
        """Return a citation for each work, sorted by key."""
        self.state.document.settings.env.note_dependency(str(FILE))
        return [self._registered(key, fields) for key, fields in sorted(works().items())]

    def _registered(self, key: str, fields: dict[str, str]) -> nodes.citation:
        citation = _citation(key, fields)
        name = nodes.fully_normalize_name(key)
        citation["names"].append(name)
        self.state.document.note_citation(citation)
        self.state.document.note_explicit_target(citation, citation)
        return citation


def _cite(
    _name: str, _rawtext: str, key: str, *_: Any
) -> tuple[list[nodes.Node], list[nodes.system_message]]:
    """Return the same citation as [Key]_ in reStructuredText."""
    return [nodes.citation_reference(f"[{key}]_", key, refname=key)], []


def _note_used(_app: Sphinx, environment: Any) -> None:
    """Mark every work as cited, so that Sphinx gives no warning about uncited works."""
    domain = environment.get_domain("citation")
    for key in domain.citations:
        domain.citation_refs.setdefault(key, set()).add("references")


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the directive and the role."""
    app.add_directive("bibliography", _Bibliography)
    app.add_role("cite", _cite)
    app.connect("env-updated", _note_used, priority=100)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
