"""Check the files and functions that an untrusted study may use, and record their contents.

A study file is data: specs are parsed, never evaluated.
Files are read only from the study's folder and from folders that the caller allows.
Python functions are imported only if the caller names them.
The SHA-256 of every input file is recorded, because a changed file makes another study.
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
from mcspectra.core.trust import FILE_KEYS, FUNCTION, Trust, loaded_function
from mcspectra.samplers.external import allow_own_code

__all__ = ["Inputs", "Trust", "Vetting", "changed_inputs", "check_inputs"]

Inputs: TypeAlias = tuple[str, ...]
"""Names of files that a cell depends on, in ascending order."""

_NAMED = 3  # Maximum number of files named in a message


@final
class Vetting:
    """Checks each text of a study once; later code trusts the returned values.

    Parameters
    ----------
    folder
        Folder from which relative paths start.
        Files in this folder are named by their relative path, and other files by their whole path.
        Modules are named as in Python, because their folders differ between machines.
    trust
        Files and functions that are allowed beyond the folder.

    Attributes
    ----------
    inputs
        SHA-256 by name of all used files: files of specs and scenes, and sources of functions.
        A path that is not a readable file is refused later by its reader.
    """

    def __init__(self, folder: Path, trust: Trust) -> None:
        self.inputs: dict[str, str] = {}
        self._folder = folder
        self._trust = trust
        self._reach = trust.widened(folders=(folder.resolve(),))
        self._digests: dict[Path, str] = {}
        self._calls: dict[str, tuple[list[Call], Inputs]] = {}

    def calls(self, text: str) -> tuple[list[Call], Inputs]:
        """Parse a spec, and replace the paths in it by paths of allowed files.

        Paths in nested specs are replaced as well.

        Raises
        ------
        SpecError
            If the spec cannot be read.
        ConfigError
            If a file is outside the allowed folders.
        """
        if text not in self._calls:
            files: dict[Path, str] = {}
            found = [self._call(call, files) for call in parse_chain(text)]
            self._calls[text] = found, self._names(files)
        return self._calls[text]

    def sampler(self, text: str) -> tuple[list[Call], Inputs]:
        """Parse the spec of a sampler as in `calls`; a sampler that runs code must be allowed.

        Programs and modules of functions are recorded as inputs.
        Relative paths of programs are relative to the folder of the study.

        Raises
        ------
        ConfigError
            If a file is outside the allowed folders, or if the code is not allowed.
        """
        (first, *rest), inputs = self.calls(text)
        self._trust.check_code(first)
        files: dict[Path, str] = {}
        match first.name, first.arguments:
            case "command", {"run": str(run)}:
                # If the command cannot be split into words, the sampler raises an error later
                with suppress(ValueError):
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
        """Check the options of an analysis in the same way as the arguments of a spec.

        Raises
        ------
        ConfigError
            Same as in `calls`.
        """
        files: dict[Path, str] = {}
        given = Call("", msgspec.structs.asdict(analysis))
        found = self._call(given, files).arguments.items()
        vetted = {key: tuple(each) if isinstance(each, list) else each for key, each in found}
        return msgspec.structs.replace(analysis, **vetted), self._names(files)

    def function(self, text: str, call: Call) -> tuple[Callable[..., Any], Inputs]:
        """Import the function of a call ``python(function='module:function')``, given as `text`.

        Raises
        ------
        ConfigError
            If the call has another form, or the function is not allowed, importable or callable.
        """
        if set(call.arguments) != {"function"}:
            raise ConfigError(f"{shown(text)}: write python(function='module:function').")
        name = call.arguments["function"]
        if isinstance(name, str) and FUNCTION.fullmatch(name) and name not in self._trust.code:
            raise ConfigError(
                f"The study names the Python function {shown(name)}, but a study file may not run "
                f"code; if you trust it, allow it with --allow-code {name}."
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
            # Only lists under the key "path" hold files; other lists hold digits of matrices
            return [self._argument(key if key == "path" else "", item, files) for item in value]
        if isinstance(value, dict):
            return {k: self._argument(str(k), item, files) for k, item in value.items()}
        if not isinstance(value, str):
            return value
        # The text before any parameters is the name of a scene, or the name of a file
        name = value.partition("(")[0]
        is_file = value.lower().endswith(".xml") or "/" in name or "\\" in name
        if key in FILE_KEYS or (key == "scene" and is_file):
            file = self._file(value, files, scene=key == "scene")
            if key == "path" and not file.is_file():
                with suppress(FileFormatError):  # No file matches the pattern
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
        """Resolve a path relative to the folder, and follow links to check where the file is.

        A study must not explore the disk of the person who runs it.
        """
        if "\0" in path or path.startswith("~"):  # a tilde stands for a home folder
            raise ConfigError(f"{shown(path)} is not a file name; write it without ~.")
        file = self._folder / path
        if not self._reach.reads(file):
            raise ConfigError(
                f"The file {shown(path)} is outside the study's folder; move it there, or allow "
                f"its folder with --allow-path {file.parent}."
            )
        files[file] = ""
        if scene or file.suffix.lower() == ".xml":
            from mcspectra.rendering.scenes import referenced_files

            files.update(dict.fromkeys(referenced_files(file, trust=self._reach), ""))
        return file

    def _names(self, files: Mapping[Path, str]) -> Inputs:
        """Return the names of the readable files, and record them; skip pipes and devices."""
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
    """Return the files of the module that names a function and of the module that defines it.

    Files of other modules, such as imported modules, are not included.
    """
    module = name.partition(":")[0]
    modules = {module, str(getattr(found, "__module__", module))}
    sources = {each: getattr(sys.modules.get(each), "__file__", None) for each in modules}
    return {Path(file): f"module {each}" for each, file in sources.items() if file is not None}


def changed_inputs(before: Mapping[str, str], now: Mapping[str, str]) -> Inputs:
    """Return the names of files that were changed, added or removed."""
    return tuple(name for name in sorted({*before, *now}) if before.get(name) != now.get(name))


def check_inputs(
    before: Mapping[str, str], now: Mapping[str, str], whose: str, remedy: str
) -> None:
    """Raise an error if input files have changed.

    Parameters
    ----------
    whose
        Start of the message, such as ``The results in 'out' are``.
    remedy
        End of the message: advice to the user.

    Raises
    ------
    StoreError
        If files have changed; the message names the first few.
    """
    changed = changed_inputs(before, now)
    if changed:
        more = f" and {len(changed) - _NAMED} more" if len(changed) > _NAMED else ""
        names = ", ".join(map(repr, changed[:_NAMED])) + more
        what = "the file" if len(changed) == 1 else "the files"
        raise StoreError(f"{whose} from another version of {what} {names}: {remedy}.")
