"""Specs that came from a URL: text that is bounded, plain, and names no file.

A page of somebody else can link to the explorer. What such a link holds may make it compute, but it
must not make it open files: pictures come in by an upload, which is named by its digest.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from mcspectra.core.errors import SpecError
from mcspectra.core.spec import Call, parse, parse_chain

__all__ = ["FORMULA", "UPLOAD", "check_chain", "check_integrand", "check_single"]

UPLOAD = "upload"
"""Name of the integrand ``upload(digest='…')``: a picture that the user gave to the explorer."""

FORMULA = "formula"
"""Name of the integrand that is a formula."""

_MOST_TEXT = 2000  # characters of a spec: browsers and servers cut URLs off at about 8000
_DIGEST = re.compile(r"[0-9a-f]{64}")
_FILE = re.compile(r"[/\\]|\.[A-Za-z]\w*\Z")
_FILE_KEYS = ("path", "filename", "matrices", "generating_matrices", "generating_vector")
_CONTROL = re.compile(r"[\x00-\x1f\x7f\ud800-\udfff]")


def check_chain(name: str, text: object) -> None:
    """Check a spec that may chain parts by ``|``.

    Raises
    ------
    SpecError
        Not text, too long, not a spec, or one that names a file.
    """
    for call in parse_chain(_plain(name, text)):
        _check_call(call)


def check_single(name: str, text: object) -> None:
    """Check a spec without ``|``; raises as `check_chain`."""
    _check_call(parse(_plain(name, text)))


def check_integrand(name: str, text: object) -> None:
    """Check the spec of an integrand, which may be ``upload(digest='…')`` with a SHA-256 digest."""
    call = parse(_plain(name, text))
    if call.name != UPLOAD:
        _check_call(call)
        return
    digest = call.arguments.get("digest")
    known = isinstance(digest, str) and _DIGEST.fullmatch(digest)
    if list(call.arguments) != ["digest"] or not known:
        raise SpecError("An upload is named by its SHA-256 digest; choose the picture again.")


def _plain(name: str, text: object) -> str:
    if not isinstance(text, str) or not text.strip():
        raise SpecError(f"{name} is {text!r}; give a spec such as name(key=value).")
    if len(text) > _MOST_TEXT:
        raise SpecError(
            f"{name} has {len(text)} characters; the explorer takes {_MOST_TEXT} at most."
        )
    if _CONTROL.search(text):
        raise SpecError(f"{name} holds a control character; write it on one line of plain text.")
    return text


def _check_call(call: Call) -> None:
    arguments = dict(call.arguments)
    if call.name == FORMULA:
        arguments.pop("expression", None)  # has slashes and dots, and never names a file
    _check_mapping(call.name, arguments)


def _check_mapping(name: str, values: Mapping[Any, Any]) -> None:
    for key, value in values.items():
        if key in _FILE_KEYS and isinstance(value, str | list | tuple):
            raise SpecError(
                f"{name} names a file, which the explorer does not read; upload a picture, "
                "or use the command line."
            )
        _check_value(name, value)


def _check_value(name: str, value: object) -> None:
    """Refuse file names, also within the specs that a value may hold."""
    if isinstance(value, list | tuple | set):
        for item in value:
            _check_value(name, item)
    elif isinstance(value, dict):
        _check_mapping(name, value)
    elif isinstance(value, str):
        _check_string(name, value)


def _check_string(name: str, value: str) -> None:
    try:
        calls = parse_chain(value)
    except SpecError:
        calls = []
    for call in calls:
        _check_call(call)
    if not calls and _FILE.search(value):
        raise SpecError(
            f"{name} was given {value[:40]!r}, which looks like a file; the explorer reads none."
        )
