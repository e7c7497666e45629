"""Escape characters of docstrings that reStructuredText would read as markup."""

import re
from typing import Any

from sphinx.application import Sphinx

__all__ = ["escaped", "setup"]

# This markup is not escaped: ``literals``, `references`, *emphasis*, **strong** and [Key]_
_MARKUP = re.compile(
    r"(``.+?``"
    r"|`[^`\s][^`]*?`_{0,2}"
    r"|\*\*[^*\s](?:[^*]*?[^*\s])?\*\*"
    r"|(?<![\w*)])\*[^*\s](?:[^*]*?[^*\s])?\*(?![\w*])"
    r"|\[\w+\]_)"
)
_SPECIAL = re.compile(r"([|*]|(?<=\w)_(?!\w))")
_PREFIX = re.compile(r"^\s*(?::[a-z]+(?: [^:]+)?:(?= |$)|[*+-] +)")  # start of a field or list item
_WORK = re.compile(r"^(\s*)\.\. (\[\w+\])(?= )")


def escaped(line: str) -> str:
    """Escape the bars, stars and trailing underscores in a line, because they are mathematics."""
    prefix = _PREFIX.match(line)
    start = prefix.end() if prefix else 0
    parts = _MARKUP.split(line[start:])
    kept = (part if at % 2 else _SPECIAL.sub(r"\\\1", part) for at, part in enumerate(parts))
    return line[:start] + "".join(kept)


def _process(*event: Any) -> None:
    """Change the lines of a docstring in place; autodoc passes them as the last argument."""
    lines: list[str] = event[-1]
    lines[:] = _with_text_escaped(_with_works_cited(lines))


def _with_works_cited(lines: list[str]) -> list[str]:
    """Turn the references of a docstring into list items that link to the page of references."""
    result, indent = [], None
    for line in lines:
        work = _WORK.match(line)
        if work:
            indent = len(work[1])
            line = _WORK.sub(r"\1-  \2_", line)
        elif indent is not None and line.strip():
            further = len(line) - len(line.lstrip()) > indent
            line = " " * (indent + 3) + line.lstrip() if further else line
            indent = indent if further else None
        result.append(line)
    return result


def _with_text_escaped(lines: list[str]) -> list[str]:
    """Escape all lines except directives, examples and literal blocks."""
    result, literal = [], None  # literal is the indentation of the line that ends in '::'
    for line in lines:
        indent = len(line) - len(line.lstrip())
        if literal is not None and line.strip() and indent <= literal:
            literal = None
        is_text = literal is None and not line.lstrip().startswith((">>>", "...", ".. "))
        if literal is None and line.rstrip().endswith("::"):
            literal = indent
        result.append(escaped(line) if is_text else line)
    return result


def setup(app: Sphinx) -> dict[str, bool]:
    """Process docstrings of autodoc after napoleon."""
    app.connect("autodoc-process-docstring", _process, priority=900)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
