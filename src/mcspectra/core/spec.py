"""Spec strings ``name(key=value, ...) | name(...)`` for the command line, TOML and Python.

Names are in kebab case.
Values are Python literals that `ast.literal_eval` reads. No code is evaluated.
`parse` converts text to `Call`s, and `format_call` converts a component back to text.
"""

from __future__ import annotations

import ast
import dataclasses
import re
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from mcspectra.core.display import QUOTED, Drawable, printable, shown
from mcspectra.core.errors import SpecError
from mcspectra.core.fields import check_fields

__all__ = ["Call", "Component", "format_call", "kebab_case", "parse", "parse_chain", "short_spec"]

_NAME = re.compile(r"[a-z][a-z0-9]*(?:-[a-z0-9]+)*")
_CAPITALS = re.compile(r"(?<=[a-z0-9])(?=[A-Z])")  # boundary between words of a class name
_WORD = re.compile(r"[A-Za-z_][\w.-]*")
_NO_NUMBERS = ("nan", "inf", "infinity")
# Components that run code, each with the one parameter whose name may be omitted in a spec
_FIRST = {"command": "run", "python": "function"}
_MAX_LENGTH = 20_000
# Matches the folders of a quoted path; also a parameter name and "=" in front of the path
_FOLDERS = re.compile(r"""(?:\w+=)?(['"])[^'"]*/(?=[^'"/]+\1)""")
_MARK = re.compile(
    r"""'(?:[^'\\]|\\.)*'|"(?:[^"\\]|\\.)*"|['"()\[\]{}|]""", re.DOTALL
)  # a quoted text counts as one token


@dataclass(frozen=True)
class Call:
    """One part ``name(key=value, ...)`` of a spec string."""

    name: str
    arguments: dict[str, Any]

    def __str__(self) -> str:
        inside = ", ".join(f"{key}={value!r}" for key, value in self.arguments.items())
        return f"{self.name}({inside})" if inside else self.name


def kebab_case(name: str) -> str:
    """Return the name that a class has in spec strings: ``latin-hypercube`` for LatinHypercube."""
    return _CAPITALS.sub("-", name).lower()


class _NameOfClass:
    """Descriptor that returns the name of its class in kebab case."""

    def __get__(self, component: object, cls: type) -> str:
        return kebab_case(cls.__name__)


class Component(Drawable):
    """Base of samplers, randomizations, densities and integrands, with a name and a spec string.

    Subclasses are dataclasses. `spec` lists the fields that differ from their defaults.
    When an instance is created, its fields from `mcspectra.core.fields` are checked first.
    After the fields, the method `_check` checks the whole instance.
    A class declares `name` if its name in specs differs from the class's name in kebab case.
    """

    name: ClassVar[str] = _NameOfClass()  # type: ignore[assignment]
    costly: ClassVar[bool] = False
    """Whether drawing the component would take seconds. If so, notebooks show no picture."""

    def __post_init__(self) -> None:
        check_fields(self)
        self._check()

    def _check(self) -> None:
        """Check combinations of parameters. Each field has already been checked alone."""

    @property
    def spec(self) -> str:
        """The spec string that recreates this component (without `dims`)."""
        return format_call(self)

    @classmethod
    def summary(cls) -> str:
        """Return the first line of the class's docstring."""
        return (cls.__doc__ or cls.__name__).strip().splitlines()[0].strip()


def parse_chain(text: str) -> list[Call]:
    """Read ``a(...) | b(...)`` into calls.

    Raises
    ------
    SpecError
        If `text` is not a string, or is empty, unbalanced, or of another form.
    """
    if not isinstance(text, str):
        raise SpecError(f"The spec is {shown(text)}; give a string such as 'jittered | shift'.")
    if len(text) > _MAX_LENGTH:
        raise SpecError(f"The spec has {len(text)} characters; at most {_MAX_LENGTH} are allowed.")
    return [_parse_call(part, text) for part in _split(text)]


def parse(text: str) -> Call:
    """Read one ``name(...)``. A chain with ``|`` is an error."""
    calls = parse_chain(text)
    if len(calls) != 1:
        raise SpecError(
            f"{shown(text)} chains {len(calls)} parts with '|'; only samplers can be chained."
        )
    return calls[0]


def short_spec(text: str) -> str:
    """Return a short spec for figures: the ``name=`` of each part, or its text without folders."""
    try:
        parts = zip(parse_chain(text), _split(text), strict=True)
        return " | ".join(
            str(call.arguments.get("name") or _FOLDERS.sub(r"\1", part.strip()))
            for call, part in parts
        )
    except SpecError:
        return text


def format_call(component: object) -> str:
    """Write a dataclass component as ``name(key=value)``, without fields that have the default."""
    given = []
    for field in dataclasses.fields(component):  # type: ignore[arg-type]
        if field.name == "dims" or not field.init:
            continue
        value, default = getattr(component, field.name), field.default
        if field.default_factory is not dataclasses.MISSING:
            default = field.default_factory()
        if isinstance(value, np.ndarray) or isinstance(default, np.ndarray):
            same = np.array_equal(np.asarray(value), np.asarray(default))
        else:
            same = type(value) is type(default) and value == default
        if not same:
            given.append(f"{field.name.rstrip('_')}={_literal(value)}")
    name = getattr(component, "name", type(component).__name__)
    return f"{name}({', '.join(given)})" if given else name


def _literal(value: object) -> str:
    if isinstance(value, np.ndarray):
        return f"<array {'x'.join(map(str, value.shape))}>"
    if isinstance(value, Component):
        return repr(value.spec)
    if isinstance(value, tuple | list):
        return f"[{', '.join(map(_literal, value))}]"
    return repr(value)


def _split(text: str) -> list[str]:
    """Split at '|' outside quotes and brackets."""
    parts, start, depth = [], 0, 0
    for mark in _MARK.finditer(text):
        depth += (mark[0] in "([{") - (mark[0] in ")]}")
        if mark[0] == "|" and depth == 0:
            parts.append(text[start : mark.start()])
            start = mark.end()
        if depth < 0:
            raise SpecError(
                f"{shown(text)} closes a bracket that it did not open, at character {mark.end()}."
            )
        if mark[0] in "'\"":
            raise SpecError(f"{shown(text)} opens a quote and does not close it.")
    if depth:
        raise SpecError(f"{shown(text)} opens a bracket and does not close it.")
    return [*parts, text[start:]]


def _parse_call(part: str, whole: str) -> Call:
    part = part.strip()
    match = _NAME.match(part)
    if not match:
        raise SpecError(
            f"{shown(part)} in {shown(whole)} does not start with a name; "
            "write name or name(key=value), names in lower case with hyphens."
        )
    name, rest = match.group(), part[match.end() :].strip()
    brief = printable(name, QUOTED)
    if not rest:
        return Call(name, {})
    if not (rest.startswith("(") and rest.endswith(")")):
        raise SpecError(f"{shown(part)} is not of the form name(key=value, ...).")

    # Parse the brackets with Python's own parser, as the arguments of a call
    source, written = f"f{rest}", printable(name + rest, QUOTED)
    try:
        tree = ast.parse(source, mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise SpecError(f"The brackets of {written} are not key=value pairs.") from None
    if not (isinstance(tree, ast.Call) and isinstance(tree.func, ast.Name)):
        raise SpecError(f"{written} is not of the form name(key=value, ...).")
    first = _FIRST.get(name)
    keywords = [(keyword.arg, keyword.value) for keyword in tree.keywords]
    if first and len(tree.args) == 1:
        keywords.insert(0, (first, tree.args[0]))
    elif tree.args:
        # ast.unparse is not used, because it recurses and fails on deep nesting
        nameless = ast.get_source_segment(source, tree.args[0]) or "a value"
        written = printable(nameless, QUOTED)
        raise SpecError(
            f"{brief} was given {written} without a name; write parameter={written}, with the name "
            "of one of its parameters."
        )
    arguments: dict[str, Any] = {}
    for key, value in keywords:
        if key is None:
            raise SpecError(f"{brief} was given '**'; only key=value is allowed.")
        if key in arguments:
            raise SpecError(f"{brief} was given {printable(key, QUOTED)} twice.")
        try:
            arguments[key] = ast.literal_eval(value)
        except (ValueError, TypeError, RecursionError, MemoryError):
            raise SpecError(
                f"The value of {printable(key, QUOTED)} in {brief}(...) is not a literal; "
                f"{_literal_advice(ast.get_source_segment(source, value) or '')}."
            ) from None
    return Call(name, arguments)


def _literal_advice(value: str) -> str:
    """Return advice for a value that is not a literal. Usually a word lacks its quotes."""
    constants = {"true": "True", "false": "False", "none": "None"}
    if value.lower() in constants:
        return f"write {constants[value.lower()]}"
    if _WORD.fullmatch(value) and value.lower() not in _NO_NUMBERS and len(value) <= QUOTED:
        return f"write {value!r} in quotes"
    given = "give a finite number" if value.lower().lstrip("+-") in _NO_NUMBERS else "give a number"
    return f"{given}, a quoted string, True, False, None, or a list of those"
