"""Count sentences that are hard to read at once, in comments, docstrings and Markdown.

Run it from the root of the repository::

    python -m tests.prose                  table by package; exit code 1 above a limit
    python -m tests.prose docs README.md   every hit below these folders and files

A hit is a place to look at, not proof of a bad sentence. CONTRIBUTING.md lists the patterns.
"""

from __future__ import annotations

import argparse
import ast
import io
import re
import sys
import tokenize
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

__all__ = ["LIMIT", "PACKAGE_LIMIT", "PATTERNS", "Sentence", "hits", "main", "sentences"]

LIMIT = 0.03
"""Largest share of sentences with a hit over all files."""
PACKAGE_LIMIT = 0.05
"""Largest share of sentences with a hit in one package."""

ROOT = Path(__file__).parents[1]
PLACES = ("src/mcspectra", "docs", "README.md", "CONTRIBUTING.md", "CHANGELOG.md", "SECURITY.md")

_AUXILIARY = r"(?:is|are|was|were|be|has|have|had|does|do|can|may|must|needs?|holds?|gives?|takes?)"
_POINTER = "those|these|that|which|them|it|others"

PATTERNS = {
    # "of the budget, by so many": a preposition opens a short phrase that has no verb
    "no subject": re.compile(
        rf"^(?:(?:of|by|beside|beyond|times) |(?:in|at|for|from|with) (?!.*\.$))"
        rf"(?!.*\b{_AUXILIARY}\b)(?!.*[,:(])(?:\S+ ?){{2,9}}$",
        re.IGNORECASE,
    ),
    # "of what is left", "What is rare was not met"
    "what as a noun": re.compile(
        r"\b(?:of|by|from|with|in|than|and|or|on|until|beside|to) what\b(?! to\b)"
        r"|^What (?!does\b|do\b|happens\b|to\b|can\b|would\b|is wrong\b)[^?]*\.$"
    ),
    # "from which on it matters", "from 64 on"
    "from … on": re.compile(r"\bfrom (?:which|where|there|[\d^.]+(?: \w+)?) on\b|\bup to where\b"),
    # "the correction is none"
    "is none": re.compile(r"\b(?:is|are|has|have|of) none\b(?! of)"),
    # "those of the others", "of those that"
    "pointers": re.compile(
        rf"\b(?:those|that|these) of (?:the )?(?:{_POINTER})\b"
        r"|\bof (?:those|these) (?:that|which)\b"
    ),
    # "Predicted is the variance", "Of this the second is left"
    "inverted": re.compile(
        r"^(?:[A-Z][a-z]+(?:ed|pt|ft) (?:is|are) (?:the|a|an|all)\b"
        r"|Of [a-z][^,]{2,40} (?:is|are) the\b)"
    ),
    # "as that of `render`"
    "as that of": re.compile(r"\b(?:[Aa]s|[Ll]ike|[Tt]han) (?:that|those|of) (?:of|`|X)"),
    # "by so many points"
    "so many": re.compile(r"\bso (?:many|much|few|often)\b(?! (?:as|for)\b)(?!.*\bthat\b)"),
    # words that have another meaning to most readers
    "false friend": re.compile(
        r"\b(?:beside|dear|dearer|mended|surely|anew|thereof|wherefrom|in place of|held against)\b"
        r"|, too\b",
        re.IGNORECASE,
    ),
    # "nets that see what g does", "nothing is known of it"
    "talking code": re.compile(
        r"\b(?:knows?|tells?|sees?|says?|asks? for) "
        r"(?:of|what|how|which|nothing|it|them|about|no)\b"
    ),
}


class Sentence(NamedTuple):
    """One sentence, with the line on which its paragraph begins."""

    line: int
    text: str


def sentences(path: Path) -> list[Sentence]:
    """Return the sentences of a Python or Markdown file; code spans are replaced by X."""
    text = path.read_text(encoding="utf-8")
    paragraphs = _of_markdown(text) if path.suffix == ".md" else _of_python(text)
    found = []
    for line, paragraph in paragraphs:
        plain = re.sub(r"``.+?``|`[^`]*`|\$[^$]+\$|\[[\w-]+\]_", "X", paragraph)
        plain = re.sub(r"\s+", " ", re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", plain)).strip()
        for part in re.split(r"(?<=[.?!:;])\s+(?=[A-Z(X*\d])", plain):
            if len(part.split()) >= 3:
                found.append(Sentence(line, part.strip(" *-")))
    return found


def hits(sentence: str) -> list[str]:
    """Return the names of the patterns that a sentence matches."""
    return [name for name, pattern in PATTERNS.items() if pattern.search(sentence)]


def _of_markdown(text: str) -> Iterator[tuple[int, str]]:
    """Paragraphs and list items outside code, tables, headings and front matter."""
    begin, parts, fence = 0, [], ""
    front = text.startswith("---\n")
    for number, line in enumerate([*text.splitlines(), ""], 1):
        bare = line.strip()
        if front:
            front = number == 1 or bare != "---"
            continue
        mark = re.match(r"`{3,}|:{3,}", bare)
        if fence:
            fence = "" if bare == fence else fence
            continue
        item = re.match(r"(?:[*+-]|\d+\.) +", bare)
        other = (
            bool(mark) or line.startswith("    ") or bare.startswith(("#", "|", "![", "$$", "<"))
        )
        if parts and (not bare or item or other):
            yield begin, " ".join(parts)
            parts = []
        if mark and mark[0][0] == "`" and not bare.endswith("}```"):
            fence = mark[0]
        elif bare and not other:
            begin = begin if parts else number
            parts.append(bare[item.end() :] if item else bare)


def _of_python(text: str) -> Iterator[tuple[int, str]]:
    """Blocks of comments, and the paragraphs of docstrings."""
    begin, parts, last = 0, [], -1
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type != tokenize.COMMENT or re.match(r"#\s*(?:noqa|type:|!|pragma)", token.string):
            continue
        row = token.start[0]
        if parts and row != last + 1:
            yield begin, " ".join(parts)
            parts = []
        begin, last = (begin if parts else row), row
        parts.append(token.string.lstrip("# "))
    if parts:
        yield begin, " ".join(parts)
    for node in ast.walk(ast.parse(text)):
        value = getattr(node, "value", None)
        value = value.value if isinstance(value, ast.Constant) else None
        if isinstance(node, ast.Expr) and isinstance(value, str):
            yield from _of_docstring(node.lineno, value)


def _of_docstring(line: int, text: str) -> Iterator[tuple[int, str]]:
    begin, parts, indent = line, [], 0
    for offset, raw in enumerate([*text.splitlines(), ""]):
        bare = raw.strip()
        level = len(raw) - len(raw.lstrip())
        code = bare.startswith((">>>", "...", ".. ", "---", "===", "|"))
        if parts and (not bare or code or level != indent or bare.startswith(("* ", "- "))):
            yield begin, " ".join(parts)
            parts = []
        if bare and not code:
            begin, indent = (begin if parts else line + offset), level if offset else indent
            parts.append(bare.lstrip("*- "))
            indent = level if offset else indent


def _package(path: Path) -> str:
    parts = path.relative_to(ROOT).parts
    return parts[2] if parts[0] == "src" and len(parts) > 3 else parts[0]


def _files(places: list[str]) -> list[Path]:
    found = []
    for place in (ROOT / each for each in places or PLACES):
        found += [place] if place.is_file() else sorted(place.rglob("*"))
    return [path for path in found if path.suffix in (".py", ".md")]


def main(arguments: list[str] | None = None) -> int:
    """Print the hits of given places, or the table by package; return the exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.prose",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("places", nargs="*", help="folders and files whose hits are listed")
    places = parser.parse_args(arguments).places
    total, hit = Counter(), Counter()
    for path in _files(places):
        for line, text in sentences(path):
            total[_package(path)] += 1
            names = hits(text)
            hit[_package(path)] += bool(names)
            if names and places:
                print(f"{path.relative_to(ROOT)}:{line}: [{', '.join(names)}] {text}")
    bad = False
    for package in sorted(total, key=lambda name: -hit[name] / total[name]):
        share = hit[package] / total[package]
        # A page of few sentences may have one hit
        over = share > PACKAGE_LIMIT and hit[package] > 1
        bad |= over
        mark = f"  above the limit of {PACKAGE_LIMIT:.0%}" if over else ""
        print(f"{package:16} {hit[package]:4} of {total[package]:5} sentences {share:6.1%}{mark}")
    share = sum(hit.values()) / max(sum(total.values()), 1)
    over = share > LIMIT
    mark = f"  above the limit of {LIMIT:.0%}" if over else ""
    print(
        f"{'all':16} {sum(hit.values()):4} of {sum(total.values()):5} sentences {share:6.1%}{mark}"
    )
    return int(bad or over)


if __name__ == "__main__":
    sys.exit(main())
