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

__all__ = [
    "FORMULA",
    "TECHNIQUES",
    "UPLOAD",
    "check_chain",
    "check_integrand",
    "check_single",
    "techniques",
]

UPLOAD = "upload"
"""Name of the integrand ``upload(digest='…')``: a picture that the user gave to the explorer."""

FORMULA = "formula"
"""Name of the integrand that is a formula."""

TECHNIQUES = "technique-sum"
"""Name of ``technique-sum(integrands=['…', '…'])``: a `mcspectra.TechniqueSum` of these specs."""

_MOST_TECHNIQUES = 8
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
    """Check the spec of an integrand, which may be an upload or a sum of techniques.

    An upload is ``upload(digest='…')`` with a SHA-256 digest, a sum `TECHNIQUES` of 2 to 8 specs.
    """
    for spec in techniques(_plain(name, text)):
        call = parse(_plain(name, spec))
        if call.name == UPLOAD:
            _check_upload(call)
        else:
            _check_call(call)


def techniques(text: str) -> list[str]:
    """Return the specs of the integrands that a spec sums, most often itself alone.

    Raises
    ------
    SpecError
        A sum of something else than 2 to 8 specs.
    """
    call = parse(text)
    if call.name != TECHNIQUES:
        return [text]
    specs: Any = call.arguments.get("integrands")
    fits = isinstance(specs, list) and 2 <= len(specs) <= _MOST_TECHNIQUES
    texts = fits and all(isinstance(spec, str) for spec in specs)
    if list(call.arguments) != ["integrands"] or not texts:
        raise SpecError(
            f"{TECHNIQUES} takes integrands=['…', '…'], a list of 2 to {_MOST_TECHNIQUES} specs."
        )
    return list(specs)


def _check_upload(call: Call) -> None:
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
