r"""Cited works: the entries of ``references.bib``. Docstrings cite their keys as [Key]\_."""

from __future__ import annotations

import re
import unicodedata
from functools import lru_cache
from pathlib import Path

__all__ = ["ADDRESS", "FILE", "address", "bibtex", "entries", "works", "written_out"]

FILE = Path(__file__).with_name("references.bib")
ADDRESS = re.compile(r"https://\S*[^\s.,:;]")
"""Pattern of web addresses in a text, without full stops and commas after them."""

_ENTRY = re.compile(r"^@\w+\{(?P<key>\w+),\n(?P<fields>.*?)^\}", re.MULTILINE | re.DOTALL)
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
_LETTERS = {r"\o": "ø", r"\l": "ł", r"\ss": "ß", r"\aa": "å", r"\AA": "Å", r"\epsilon": "ε"}
_SITES = {"doi": "https://doi.org/", "eprint": "https://arxiv.org/abs/", "url": ""}


def entries(source: str) -> dict[str, dict[str, str]]:
    """Return the fields of each entry of a BibTeX file as plain text, by the key of the entry."""
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


@lru_cache(maxsize=1)
def works() -> dict[str, dict[str, str]]:
    """Return the fields of each work in ``references.bib`` as plain text, by the work's key."""
    return entries(FILE.read_text(encoding="utf-8"))


def bibtex(key: str) -> str:
    """Return the BibTeX entry of a work."""
    source = FILE.read_text(encoding="utf-8")
    return next(entry[0] for entry in _ENTRY.finditer(source) if entry["key"] == key)


def address(fields: dict[str, str]) -> str:
    """Return the web address of a work, from its DOI if there is one. ``""`` means no address."""
    return next((site + fields[name] for name, site in _SITES.items() if name in fields), "")


def written_out(text: str) -> str:
    r"""Return `text` with authors, year, title and address instead of each known [Key]\_."""

    def work(found: re.Match[str]) -> str:
        if found[1] not in works():
            return f"[{found[1]}]"
        fields = works()[found[1]]
        names = [name.partition(",")[0] for name in fields["author"].split(" and ")]
        authors = " and ".join(names) if len(names) < 3 else f"{names[0]} et al."
        parts = [f"{authors} ({fields['year']})", fields["title"], address(fields)]
        return ", ".join(part for part in parts if part)

    apart = re.sub(r",(?= \[\w+\]_)", ";", " ".join(text.split()))
    return re.sub(r"\[(\w+)\]_", work, apart)
