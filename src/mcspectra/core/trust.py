"""Access to files and code that untrusted text names. Studies, specs and the explorer use it.

Text is data: a spec is parsed and never evaluated. But it may name code to run or files to read.
A `Trust` allows the code and the files in folders that the caller names.
Links are resolved before the check. A study can also read its own folder.
Each process has one object of the class `Trust`: `process_trust`.
The options ``--allow-code`` and ``--allow-path`` extend the permissions of the process.
The function `mcspectra.samplers.allow_code` also extends the permissions of the process.
"""

from __future__ import annotations

import importlib
import os
import re
import shlex
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, final

from mcspectra.core.display import shown
from mcspectra.core.errors import ConfigError, McspectraError, ParameterError, reason_of
from mcspectra.core.spec import Call, parse_chain

__all__ = [
    "CODE",
    "FILE_KEYS",
    "FUNCTION",
    "Trust",
    "allow",
    "loaded_function",
    "process_trust",
    "reach_of",
    "words_of",
]

CODE = {"command": "run", "python": "function"}
"""Samplers and integrands that run code, each with the parameter that contains the code."""

FILE_KEYS = (
    "path",
    "filename",
    "matrices",
    "directions",
    "generating_matrices",
    "generating_vector",
)
"""Parameters that name files: point sets, images, Mitsuba plugins, nets and QMCPy generators."""

FUNCTION = re.compile(r"[A-Za-z_][\w.]*:[A-Za-z_]\w*")
"""Form of a function name: ``module:function``."""

# Matches a function name, a whole command, or the path of a program
_NAMED = re.compile(rf"{FUNCTION.pattern}|.*[/{{].*", re.DOTALL)


@final
@dataclass(frozen=True)
class Trust:
    """Files and code that untrusted text may use. By default there are none.

    Parameters
    ----------
    code
        Functions ``module:function``, which specs ``python('module:function')`` may name.
        Commands that specs ``command('./mine {n} {seed}')`` may run.
        A program without arguments allows all commands that start this program.
        Modules are searched for on Python's path (PYTHONPATH), not in a study's folder.
        Programs are given with their paths.
    folders
        Folders whose files may be read, including those in subfolders.

    Raises
    ------
    ConfigError
        If code has another form, or if a folder is not a path.
    """

    code: tuple[str, ...] = ()
    folders: tuple[Path, ...] = ()

    def __post_init__(self) -> None:
        given: tuple[Any, Any] = self.code, self.folders
        if not all(isinstance(each, list | tuple) for each in given):
            raise ConfigError(
                f"The allowed code and folders are {shown(given)}; give a list of functions and a "
                "list of folders."
            )
        for name in given[0]:
            if not isinstance(name, str) or not _NAMED.fullmatch(name):
                raise ConfigError(
                    f"--allow-code is {shown(name)}; write module:function, a command as in the "
                    "study, or the path of its program."
                )
        for folder in given[1]:
            if not isinstance(folder, Path):
                raise ConfigError(f"--allow-path is {shown(folder)}; give the path of a folder.")

    def widened(self, code: Iterable[str] = (), folders: Iterable[Path] = ()) -> Trust:
        """Return a Trust that additionally allows this code and these folders."""
        return Trust(
            tuple(dict.fromkeys((*self.code, *code))),
            tuple(dict.fromkeys((*self.folders, *folders))),
        )

    def runs(self, call: Call) -> bool:
        """Whether a part of a spec names no code, or only code that is allowed."""
        text = call.arguments.get(CODE.get(call.name, ""))
        if not isinstance(text, str) or text in self.code:
            return True
        return call.name == "command" and not {*words_of(text)[:1]}.isdisjoint(self.code)

    def check_code(self, call: Call) -> None:
        """Raise an error if a part of a spec names code that is not allowed.

        Raises
        ------
        ConfigError
            If the code is not allowed. The message names the option that allows it.
        """
        if not self.runs(call):
            text = call.arguments[CODE[call.name]]
            raise ConfigError(
                f"{call.name}({text!r:.200}) runs code, which a spec may not do by itself: if you "
                f"trust it, allow it by --allow-code {shlex.quote(text)}, in Python by "
                "mcs.samplers.allow_code(…)."
            )

    def reads(self, path: str | os.PathLike[str]) -> bool:
        """Whether a file lies in an allowed folder after links are resolved."""
        try:
            place = Path(path).resolve()
            return any(place.is_relative_to(root.resolve()) for root in self.folders)
        # the links form a loop, or the value is not a path
        except (OSError, RuntimeError, ValueError):
            return False

    @property
    def reads_all(self) -> bool:
        """Whether all files of this machine may be read."""
        return self.reads(Path.cwd().anchor)

    def check_scene_file(self, file: Path, named: str, where: str) -> None:
        """Raise an error if a scene names a file outside the folders. The file need not exist.

        Parameters
        ----------
        file
            Location of the file on this machine.
        named
            Name of the file, as written in the scene.
        where
            XML element that contains the name, and the file of this element.

        Raises
        ------
        ConfigError
            If the file is outside the folders. The message names the option that allows it.
        """
        if not self.reads(file):
            raise ConfigError(
                f"{where} names {shown(named)}, which is outside the folders that a study may "
                "read: move the file next to the scene, or allow its folder by --allow-path "
                f"{shlex.quote(str(file.parent))}."
            )

    def check_scene_spec(self, text: str, where: str) -> None:
        """Raise an error if a spec in a scene names files or code, also in nested specs.

        Raises
        ------
        ConfigError
            If the spec names a file or code.
        """
        if (what := reach_of(text)) is not None:
            raise ConfigError(
                f"{where} has the spec {shown(text)}, which names {what}; this is not allowed in a "
                "study's scene: give the sampler in the study file."
            )


def reach_of(value: Any, key: str = "") -> str | None:
    """Return "a file" or "code" if a value, or a spec inside it, names one; otherwise None."""
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
    """Return the program and the arguments of a command, or nothing if it is not a command."""
    try:
        return shlex.split(command) if isinstance(command, str) else []
    except ValueError:
        return []


_process = Trust()


def process_trust() -> Trust:
    """Return the Trust for all text that this process reads."""
    return _process


def allow(code: Iterable[str] = (), folders: Iterable[Path] = ()) -> None:
    """Allow functions or commands, and files in folders, for all text that this process reads.

    Everything that was allowed before remains allowed.
    """
    global _process
    _process = _process.widened(code, folders)


def loaded_function(name: object) -> Callable[..., Any]:
    """Return the function ``module:function``.

    Raises
    ------
    ParameterError
        If the name has another form, cannot be imported, or is not a function.
    """
    if not isinstance(name, str) or not FUNCTION.fullmatch(name):
        raise ParameterError(f"python(function={name!r:.80}): write 'module:function'.")
    module, _, attribute = name.partition(":")
    try:
        found = getattr(importlib.import_module(module), attribute)
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # external code may raise any exception
        hint = "; name its folder in PYTHONPATH" if isinstance(error, ModuleNotFoundError) else ""
        raise ParameterError(
            f"The function {name!r} cannot be imported: {reason_of(error, 200)}{hint}."
        ) from error
    if not callable(found):
        raise ParameterError(f"{name!r} is {found!r:.80}, not a function.")
    return found  # type: ignore[no-any-return]
