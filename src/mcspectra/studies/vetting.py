"""What a study from a stranger may reach: files and functions, and what is in them.

A study file is data: specs are parsed, never evaluated. Files are read from the study's own folder
and from folders that the caller allows; Python functions are imported only if the caller names them.
What the results depend on is known by its SHA-256: with a changed file it is another study.
"""

from __future__ import annotations

import hashlib
import os
import shlex
import sys
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeAlias, final

import msgspec

from mcspectra.core.analysis import Analysis
from mcspectra.core.display import shown
from mcspectra.core.errors import (
    ConfigError,
    FileFormatError,
    McspectraError,
    ParameterError,
    StoreError,
)
from mcspectra.core.pointfiles import matching_files
from mcspectra.core.spec import Call, parse_chain
from mcspectra.core.trust import FILE_KEYS, FUNCTION, Trust
from mcspectra.samplers.external import allow_own_code, loaded_function

__all__ = ["Inputs", "Trust", "Vetting", "changed_inputs", "check_inputs"]

Inputs: TypeAlias = tuple[str, ...]
"""Names of files, ascending."""

_NAMED = 3  # in a message


@final
class Vetting:
    """Vets each text of a study once: what comes out is trusted from there on.

    Parameters
    ----------
    folder
        Relative paths start there. Files below it are named from there, others by their whole path,
        modules by their names, since they lie elsewhere on every machine.
    trust
        What may be reached beyond it.

    Attributes
    ----------
    inputs
        SHA-256 of all files that were named so far, by names for people: files of specs, what scenes
        refer to, sources of functions. What is no file, or cannot be read, is for its reader to
        refuse.
    """

    def __init__(self, folder: Path, trust: Trust) -> None:
        self.inputs: dict[str, str] = {}
        self._folder = folder
        self._trust = trust
        self._reach = trust.widened(folders=(folder.resolve(),))
        self._digests: dict[Path, str] = {}
        self._calls: dict[str, tuple[list[Call], Inputs]] = {}

    def calls(self, text: str) -> tuple[list[Call], Inputs]:
        """Parse a spec; paths in it, and in specs inside it, become those of files that may be read.

        Raises
        ------
        SpecError
            It cannot be read.
        ConfigError
            A file is outside the folders that may be read.
        """
        if text not in self._calls:
            files: dict[Path, str] = {}
            found = [self._call(call, files) for call in parse_chain(text)]
            self._calls[text] = found, self._names(files)
        return self._calls[text]

    def sampler(self, text: str) -> tuple[list[Call], Inputs]:
        """Parse the spec of a sampler as `calls` does; one that runs code must be allowed to.

        Programs, and modules of functions, become inputs; a path of a program starts in the folder.

        Raises
        ------
        ConfigError
            As of `calls`, or the code is not allowed.
        """
        (first, *rest), inputs = self.calls(text)
        self._trust.check_code(first)
        files: dict[Path, str] = {}
        match first.name, first.arguments:
            case "command", {"run": str(run)}:
                with suppress(ValueError):  # no command: its sampler refuses it
                    program, *others = shlex.split(run)
                    if "/" in program:
                        file = (self._folder / program).absolute()
                        files[file] = ""
                        run = shlex.join([str(file), *others])
                        first = Call("command", {**first.arguments, "run": run})
                allow_own_code(run)
            case "python", {"function": str(name)}:
                allow_own_code(name)
                files = _sources(name, loaded_function(name))
        return [first, *rest], tuple(sorted({*inputs, *self._names(files)}))

    def options(self, analysis: Analysis) -> tuple[Analysis, Inputs]:
        """Vet the options of an analysis as the arguments of a spec.

        Raises
        ------
        ConfigError
            As of `calls`.
        """
        files: dict[Path, str] = {}
        given = Call("", msgspec.structs.asdict(analysis))
        found = self._call(given, files).arguments.items()
        vetted = {key: tuple(each) if isinstance(each, list) else each for key, each in found}
        return msgspec.structs.replace(analysis, **vetted), self._names(files)

    def function(self, text: str, call: Call) -> tuple[Callable[..., Any], Inputs]:
        """Import the function of a call ``python(function='module:function')``, written as `text`.

        Raises
        ------
        ConfigError
            It is written otherwise, is not allowed, cannot be imported, or is no function.
        """
        if set(call.arguments) != {"function"}:
            raise ConfigError(f"{shown(text)}: write python(function='module:function').")
        name = call.arguments["function"]
        if isinstance(name, str) and FUNCTION.fullmatch(name) and name not in self._trust.code:
            raise ConfigError(
                f"The study names the Python function {shown(name)}, and a study file may not run code: if "
                f"you trust it, allow it by --allow-code {name}."
            )
        try:
            found = loaded_function(name)
        except ParameterError as error:
            raise ConfigError(str(error)) from error
        return found, self._names(_sources(name, found))

    def _call(self, call: Call, files: dict[Path, str]) -> Call:
        given = call.arguments.items()
        return Call(call.name, {key: self._argument(key, value, files) for key, value in given})

    def _argument(self, key: str, value: Any, files: dict[Path, str]) -> Any:
        if isinstance(value, list | tuple):
            # Only of paths may there be several; the rows of a net's matrices are digits.
            return [self._argument(key if key == "path" else "", item, files) for item in value]
        if isinstance(value, dict):
            return {k: self._argument(str(k), item, files) for k, item in value.items()}
        if not isinstance(value, str):
            return value
        name = value.partition("(")[0]  # of a scene, with parameters after it, unless it is a file
        is_file = value.lower().endswith(".xml") or "/" in name or "\\" in name
        if key in FILE_KEYS or (key == "scene" and is_file):
            file = self._file(value, files, scene=key == "scene")
            if key == "path" and not file.is_file():
                with suppress(FileFormatError):  # there are no such files
                    for each, _ in matching_files(file):
                        self._file(str(each), files)
            return str(file)
        try:
            given = parse_chain(value)
        except McspectraError:
            return value
        found = [self._call(call, files) for call in given]
        if found == given:
            return value
        return " | ".join(map(str, found))

    def _file(self, path: str, files: dict[Path, str], *, scene: bool = False) -> Path:
        """The file, found from the folder; links are followed to see where it is.

        A study may not look around on the disk of who runs it.
        """
        if "\0" in path or path.startswith("~"):  # a folder of the user's
            raise ConfigError(f"{shown(path)} is not the name of a file; write it without ~.")
        file = self._folder / path
        if not self._reach.reads(file):
            raise ConfigError(
                f"The file {shown(path)} is outside the study's folder; move it there, or allow its folder "
                f"by --allow-path {file.parent}."
            )
        files[file] = ""
        if scene or file.suffix.lower() == ".xml":
            from mcspectra.rendering.scenes import referenced_files

            files.update(dict.fromkeys(referenced_files(file, trust=self._reach), ""))
        return file

    def _names(self, files: Mapping[Path, str]) -> Inputs:
        """Names of the files that can be read, which become inputs; pipes and devices cannot."""
        found = set()
        for file, name in files.items():
            path = file.resolve()
            if not (path.is_file() and os.access(path, os.R_OK)):
                continue
            if path not in self._digests:
                with path.open("rb") as stream:
                    self._digests[path] = hashlib.file_digest(stream, "sha256").hexdigest()
            root = self._folder.resolve()
            inside = path.is_relative_to(root)
            name = name or (path.relative_to(root).as_posix() if inside else str(path))
            self.inputs[name] = self._digests[path]
            found.add(name)
        return tuple(sorted(found))


def _sources(name: str, found: object) -> dict[Path, str]:
    """Modules that a function was named in and that define it; what these import is not followed."""
    module = name.partition(":")[0]
    modules = {module, str(getattr(found, "__module__", module))}
    sources = {each: getattr(sys.modules.get(each), "__file__", None) for each in modules}
    return {Path(file): f"module {each}" for each, file in sources.items() if file is not None}


def changed_inputs(before: Mapping[str, str], now: Mapping[str, str]) -> Inputs:
    """Names of files that have changed, come or gone."""
    return tuple(name for name in sorted({*before, *now}) if before.get(name) != now.get(name))


def check_inputs(
    before: Mapping[str, str], now: Mapping[str, str], whose: str, remedy: str
) -> None:
    """Refuse files that have changed.

    Parameters
    ----------
    whose
        What has, or had, the files of `before`.
    remedy
        What to do about it.

    Raises
    ------
    StoreError
        It names the first few of them.
    """
    changed = changed_inputs(before, now)
    if changed:
        more = f" and {len(changed) - _NAMED} more" if len(changed) > _NAMED else ""
        names = ", ".join(map(repr, changed[:_NAMED])) + more
        what = "the file" if len(changed) == 1 else "the files"
        raise StoreError(f"{whose} not of {what} {names} as found now: {remedy}.")
