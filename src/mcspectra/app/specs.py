"""Check and change specs in the explorer: plain text of limited length that names no files.

Any web page can contain a link to the explorer.
A link to the explorer may cause computation, but must not open files or run code.
Pictures are therefore uploaded, and specs name them by their digest.
The user who starts the explorer may allow folders (``--allow-path``) and code (``--allow-code``).
The module `mcspectra.core.trust` contains the rules for specs from strangers.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from mcspectra.core.errors import McspectraError, SpecError
from mcspectra.core.pointfiles import matching_files
from mcspectra.core.spec import Call, parse, parse_chain
from mcspectra.core.trust import FILE_KEYS, process_trust
from mcspectra.samplers.external import check_code
from mcspectra.samplers.registry import RUN_CODE

__all__ = [
    "FORMULA",
    "TECHNIQUES",
    "UPLOAD",
    "base_and_steps",
    "chain",
    "changed",
    "check_spec",
    "techniques",
]

UPLOAD = "upload"
"""Name of the integrand ``upload(digest='…')``, a picture that was uploaded to the explorer."""

FORMULA = "formula"
"""Name of the integrand that evaluates a formula."""

TECHNIQUES = "technique-sum"
"""Name of an estimator that adds techniques: ``technique-sum(integrands=['…', '…'])``.

The name stands for the class `mcspectra.estimators.TechniqueSum`.
"""

_MOST_TECHNIQUES = 8
# Maximum length of a spec in characters. Browsers and servers cut URLs at about 8000
_MOST_TEXT = 2000
_DIGEST = re.compile(r"[0-9a-f]{64}")
_FILE = re.compile(r"[/\\]|\.[A-Za-z]\w*\Z")
_CONTROL = re.compile(r"[\x00-\x1f\x7f\ud800-\udfff]")


def _allowed(given: object) -> bool:
    """Whether all files of a path, a pattern or a list are in allowed folders."""
    if isinstance(given, list | tuple):
        return all(map(_allowed, given))

    trust = process_trust()
    try:
        path = Path(str(given))
        return trust.reads(path) and all(trust.reads(file) for file, _ in matching_files(path))
    except (McspectraError, OSError, RuntimeError):
        return False


def check_spec(name: str, text: object) -> None:
    """Check the spec of a sampler, a density or an integrand.

    The spec of a sampler may chain parts with ``|``.
    An integrand may also be ``upload(digest='…')`` with a SHA-256 digest, or a sum of `TECHNIQUES`.

    Raises
    ------
    SpecError
        If `text` is not a text, too long, not a spec, or names a file.
    """
    plain = _plain(name, text)
    if name == "sampler":
        calls = parse_chain(plain)
    elif name == "integrand":
        calls = [parse(_plain(name, spec)) for spec in techniques(plain)]
    else:
        calls = [parse(plain)]
    for call in calls:
        if name == "integrand" and call.name == UPLOAD:
            digest = call.arguments.get("digest")
            known = isinstance(digest, str) and _DIGEST.fullmatch(digest)
            if list(call.arguments) != ["digest"] or not known:
                raise SpecError(
                    "An upload is named by its SHA-256 digest; choose the picture again."
                )
        else:
            _check_call(call)


def techniques(text: str) -> list[str]:
    """Return the specs of the integrands in a sum of techniques, as a list.

    If `text` is the spec of another integrand, the list contains only this spec.

    Raises
    ------
    SpecError
        If a sum does not consist of 2 to 8 specs.
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


def base_and_steps(text: str) -> tuple[str, list[str]]:
    """Return the name of the sampler in a chain, and the names of its randomizations.

    Raises
    ------
    SpecError
        If `text` is not a chain.
    """
    first, *rest = parse_chain(text)
    return first.name, [call.name for call in rest]


def chain(base: str, steps: Sequence[str], text: str) -> str:
    """Join the names of a sampler and of its randomizations with ``|``, and return the spec.

    If a name also occurs in the spec `text`, it keeps its parameters from there.
    """
    try:
        known = {call.name: str(call) for call in parse_chain(text)}
    except McspectraError:
        known = {}
    return " | ".join(known.get(name, name) for name in (base, *steps))


def changed(text: str, key: str, value: float | str) -> str:
    """Return the spec with a new value for one parameter."""
    call = parse(text)
    return str(Call(call.name, {**call.arguments, key: value}))


def _plain(name: str, text: object) -> str:
    if not isinstance(text, str) or not text.strip():
        raise SpecError(f"{name} is {text!r}; give a spec such as name(key=value).")
    if len(text) > _MOST_TEXT:
        raise SpecError(
            f"{name} has {len(text)} characters; the explorer accepts at most {_MOST_TEXT}."
        )
    if _CONTROL.search(text):
        raise SpecError(f"{name} holds a control character; write it on one line of plain text.")
    return text


def _check_call(call: Call) -> None:
    arguments = dict(call.arguments)
    if call.name in RUN_CODE:
        # Only the user who starts the explorer can allow code; a link to a page cannot
        check_code(call)
        arguments = {k: v for k, v in arguments.items() if k not in ("run", "function")}
    if call.name == FORMULA:
        arguments.pop("expression", None)  # a formula may have slashes and dots, but names no file
    for key, value in arguments.items():
        _check_value(call.name, key, value)


def _check_value(name: str, key: Any, value: object) -> None:
    """Reject file names, including those inside lists and nested specs."""
    if key in FILE_KEYS and isinstance(value, str | list | tuple):
        if process_trust().folders and _allowed(value):
            return
        raise SpecError(
            f"{name} names a file, which the explorer does not read; upload a picture, start the "
            "explorer with --allow-path DIR, or use the command line."
        )
    if isinstance(value, dict):
        for inner, each in value.items():
            _check_value(name, inner, each)
    elif isinstance(value, list | tuple | set):
        for each in value:
            _check_value(name, None, each)
    elif isinstance(value, str):
        try:
            calls = parse_chain(value)
        except SpecError:
            calls = []
        for call in calls:
            _check_call(call)
        if not calls and _FILE.search(value):
            raise SpecError(
                f"{name} was given {value[:40]!r}, which looks like a file; the explorer reads no "
                "files."
            )
