"""The directive ``bibliography``, a page of all works, and the role ``cite``.

Docstrings cite a work as [Key]_, Markdown pages as {cite}`Key`.
"""

import re
import unicodedata
from pathlib import Path
from typing import Any

from docutils import nodes
from docutils.parsers.rst import Directive
from sphinx.application import Sphinx

__all__ = ["entries", "setup"]

_ENTRY = re.compile(r"^@\w+\{(?P<key>[\w:.-]+),\n(?P<fields>.*?)^\}", re.MULTILINE | re.DOTALL)
_FIELD = re.compile(r"^\s*(\w+)\s*=\s*\{(.*?)\},?\s*$", re.MULTILINE)
_ACCENTS = {
    "'": "\u0301",
    "`": "\u0300",
    '"': "\u0308",
    "^": "\u0302",
    "~": "\u0303",
    "v": "\u030c",
}
_ACCENT = re.compile(r"""\{?\\(['`"^~]|v(?=[{ ]))\s*\{?\\?(\w)\}?\}?""")
_LETTERS = {r"\o": "ø", r"\l": "ł", r"\ss": "ß", r"\aa": "å", r"\epsilon": "ε"}


def entries(source: str) -> dict[str, dict[str, str]]:
    """Fields of each entry of a BibTeX file by its key, as plain text."""
    return {
        entry["key"]: {name.lower(): _plain(text) for name, text in _FIELD.findall(entry["fields"])}
        for entry in _ENTRY.finditer(source)
    }


def _plain(text: str) -> str:
    for command, letter in _LETTERS.items():
        text = re.sub(rf"\{{?{re.escape(command)}(?![a-z])\s*\}}?", letter, text)
    text = _ACCENT.sub(lambda found: found[2] + _ACCENTS[found[1]], text)
    text = text.replace("``", "“").replace("''", "”").replace("--", "–")
    text = re.sub(r"\^\{([^{}]+)\}", r"^(\1)", text)
    return unicodedata.normalize("NFC", re.sub(r"[{}$]|\\(?=[&_%])", "", text))


def _authors(text: str) -> str:
    names = [" ".join(reversed(name.split(", ", 1))) for name in text.split(" and ")]
    return ", ".join(names)


def _links(fields: dict[str, str]) -> list[nodes.Node]:
    where = {
        "doi": "https://doi.org/",
        "eprint": "https://arxiv.org/abs/",
        "url": "",
    }
    found = next((name for name in where if name in fields), None)
    if found is None:
        return []
    label = {"doi": "doi ", "eprint": "arXiv ", "url": ""}[found] + fields[found]
    return [
        nodes.Text(" "),
        nodes.reference("", label, refuri=where[found] + fields[found]),
        nodes.Text("."),
    ]


def _citation(key: str, fields: dict[str, str]) -> nodes.citation:
    parts = [fields.get(name) for name in ("journal", "booktitle", "publisher", "school", "note")]
    place = next((part for part in parts if part), None)
    paragraph = nodes.paragraph("", f"{_authors(fields.get('author', ''))}: ")
    paragraph += nodes.emphasis("", fields.get("title", key))
    tail = [part for part in (place, fields.get("year")) if part]
    paragraph += nodes.Text("".join(f", {part}" for part in tail) + ".")
    paragraph += _links(fields)
    return nodes.citation("", nodes.label("", key), paragraph)


class _Bibliography(Directive):
    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Return a citation for each entry of the named file, by key."""
        environment = self.state.document.settings.env
        relative, path = environment.relfn2path(self.arguments[0])
        environment.note_dependency(relative)
        found = entries(Path(path).read_text(encoding="utf-8"))
        return [self._registered(key, found[key]) for key in sorted(found)]

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
    """What [Key]_ makes in reStructuredText."""
    return [nodes.citation_reference(f"[{key}]_", key, refname=key)], []


def _note_used(_app: Sphinx, environment: Any) -> None:
    """Works that nothing cites are listed all the same: no warning about them."""
    domain = environment.get_domain("citation")
    for key in domain.citations:
        domain.citation_refs.setdefault(key, set()).add("references")


def setup(app: Sphinx) -> dict[str, bool]:
    """Register directive and role."""
    app.add_directive("bibliography", _Bibliography)
    app.add_role("cite", _cite)
    app.connect("env-updated", _note_used, priority=100)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
