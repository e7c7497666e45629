"""Files and code that text of strangers may reach: one policy for studies, specs and the explorer.

Text is data: a spec is parsed, never evaluated. It may name code to run, and files to read. A `Trust` says
which: the code that the caller names, and files in folders that the caller names, links followed. A study
has its own folder in addition; the process has one Trust, `process_trust`, which the command's options
``--allow-code`` and ``--allow-path`` and `mcspectra.samplers.allow_code` widen.
"""

from __future__ import annotations

import os
import re
import shlex
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, final

from mcspectra.core.display import shown
from mcspectra.core.errors import ConfigError, McspectraError
from mcspectra.core.spec import Call, parse_chain

__all__ = [
    "CODE",
    "FILE_KEYS",
    "FUNCTION",
    "Trust",
    "allow",
    "process_trust",
    "reach_of",
    "words_of",
]

CODE = {"command": "run", "python": "function"}
"""Samplers that run code, and the parameter that names it."""

FILE_KEYS = (
    "path",
    "filename",
    "matrices",
    "directions",
    "generating_matrices",
    "generating_vector",
)
"""Parameters that name files: point sets and images, Mitsuba's plugins, digital nets, QMCPy's generators."""

FUNCTION = re.compile(r"[A-Za-z_][\w.]*:[A-Za-z_]\w*")
"""How a function is written: ``module:function``."""

_NAMED = re.compile(
    rf"{FUNCTION.pattern}|.*[/{{].*", re.DOTALL
)  # or a command, or a program's path


@final
@dataclass(frozen=True)
class Trust:
    """Files and code that text of a stranger may reach; nothing by default.

    Parameters
    ----------
    code
        Functions ``module:function`` that specs ``python('module:function')`` may name, and commands,
        or their programs, that specs ``command('./mine {n} {seed}')`` may. Modules are looked for
        where Python looks (PYTHONPATH), not in a study's folder; programs with a path in it.
    folders
        Folders that files may be read from, and below.

    Raises
    ------
    ConfigError
        Code is written otherwise, or a folder is not a path.
    """

    code: tuple[str, ...] = ()
    folders: tuple[Path, ...] = ()

    def __post_init__(self) -> None:
        given: tuple[Any, Any] = self.code, self.folders
        if not all(isinstance(each, list | tuple) for each in given):
            raise ConfigError(
                f"Allowed are {shown(given)}; give a list of functions and one of folders."
            )
        for name in given[0]:
            if not isinstance(name, str) or not _NAMED.fullmatch(name):
                raise ConfigError(
                    f"--allow-code is {shown(name)}; write module:function, or a command as the study has "
                    "it, or the path of its program."
                )
        for folder in given[1]:
            if not isinstance(folder, Path):
                raise ConfigError(f"--allow-path is {shown(folder)}; give the path of a folder.")

    def widened(self, code: Iterable[str] = (), folders: Iterable[Path] = ()) -> Trust:
        """Return what also reaches this code and these folders."""
        return Trust(
            tuple(dict.fromkeys((*self.code, *code))),
            tuple(dict.fromkeys((*self.folders, *folders))),
        )

    def runs(self, call: Call) -> bool:
        """Whether a part of a spec names no code, or code that may run."""
        text = call.arguments.get(CODE.get(call.name, ""))
        if not isinstance(text, str) or text in self.code:
            return True
        return call.name == "command" and not {*words_of(text)[:1]}.isdisjoint(self.code)

    def check_code(self, call: Call) -> None:
        """Refuse a part of a spec that names code which may not run.

        Raises
        ------
        ConfigError
            The message names the option that allows it.
        """
        if not self.runs(call):
            text = call.arguments[CODE[call.name]]
            raise ConfigError(
                f"{call.name}({text!r:.200}) runs code, which a spec may not do by itself: if you trust it, "
                f"allow it by --allow-code {shlex.quote(text)}, in Python by mcs.samplers.allow_code(…)."
            )

    def reads(self, path: str | os.PathLike[str]) -> bool:
        """Whether a file lies in a folder that may be read; links are followed to see where it is."""
        try:
            place = Path(path).resolve()
            return any(place.is_relative_to(root.resolve()) for root in self.folders)
        except (OSError, RuntimeError, ValueError):  # a loop of links, or no path
            return False

    @property
    def reads_all(self) -> bool:
        """Whether every file of this machine may be read."""
        return self.reads(Path.cwd().anchor)

    def check_scene_file(self, file: Path, named: str, where: str) -> None:
        """Refuse a file that a scene names, whether it exists or not, outside the folders.

        Parameters
        ----------
        file
            Where it would be.
        named
            The name in the scene.
        where
            The element and the file that name it.

        Raises
        ------
        ConfigError
            The message names the option that allows it.
        """
        if not self.reads(file):
            raise ConfigError(
                f"{where} names {shown(named)}, which is outside the folders that a study may read: move "
                f"the file beside the scene, or allow its folder by --allow-path {shlex.quote(str(file.parent))}."
            )

    def check_scene_spec(self, text: str, where: str) -> None:
        """Refuse a spec in a scene that names files or code, also in a spec inside it.

        Raises
        ------
        ConfigError
            The spec names a file or code.
        """
        if (what := reach_of(text)) is not None:
            raise ConfigError(
                f"{where} has the spec {shown(text)}, which names {what}; a scene of a study may not: give "
                "the sampler in the study file."
            )


def reach_of(value: Any, key: str = "") -> str | None:
    """Return "a file" or "code" if a value of a spec, or a spec inside it, names one; else None."""
    if isinstance(value, dict):
        found = [reach_of(each, str(inner)) for inner, each in value.items()]
    elif isinstance(value, list | tuple | set):
        found = [reach_of(each, key) for each in value]
    elif not isinstance(value, str):
        found = []
    elif key in FILE_KEYS:
        return "a file"
    else:
        try:
            calls = parse_chain(value)
        except McspectraError:
            return None
        if any(call.name in CODE for call in calls):
            return "code"
        found = [reach_of(call.arguments) for call in calls]
    return next((each for each in found if each), None)


def words_of(command: object) -> list[str]:
    """Return program and arguments of a command; empty if the text is not a command."""
    try:
        return shlex.split(command) if isinstance(command, str) else []
    except ValueError:
        return []


_process = Trust()


def process_trust() -> Trust:
    """Return what text that this process reads may reach."""
    return _process


def allow(code: Iterable[str] = (), folders: Iterable[Path] = ()) -> None:
    """Also let text that this process reads reach this code and these folders."""
    global _process
    _process = _process.widened(code, folders)
