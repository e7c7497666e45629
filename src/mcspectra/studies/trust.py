"""Spec strings of a study: what files they may read and what code they may name.

A study file is data: specs are parsed, never evaluated. Files are read from the study's own folder
and from folders that the caller allows; Python functions are imported only if the caller names them.
"""

from __future__ import annotations

import importlib
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, final

from mcspectra.core.errors import ConfigError, McspectraError
from mcspectra.core.registry import Registry
from mcspectra.core.spec import Call, parse_chain
from mcspectra.studies.foreign_code import explain
from mcspectra.studies.inputs import function_sources, with_references

__all__ = ["Site", "Trust"]

_FUNCTION = re.compile(r"[A-Za-z_][\w.]*:[A-Za-z_]\w*")
# Files of point sets and images, of Mitsuba's plugins, of digital nets, and of QMCPy's generators.
_FILES = ("path", "filename", "matrices", "generating_matrices", "generating_vector")


@final
@dataclass(frozen=True)
class Trust:
    """What a study may reach beyond its own folder.

    Parameters
    ----------
    code
        Functions ``module:function`` that specs ``python(function='module:function')`` may name.
        Modules are looked for where Python looks (PYTHONPATH), not in the study's folder.
    folders
        Further folders that files may be read from.

    Raises
    ------
    ConfigError
        A function is not written as ``module:function``.
    """

    code: tuple[str, ...] = ()
    folders: tuple[Path, ...] = ()

    def __post_init__(self) -> None:
        for name in self.code:
            if not _FUNCTION.fullmatch(name):
                raise ConfigError(f"--allow-code is {name!r}; write module:function.")


@final
@dataclass(frozen=True)
class Site:
    """The folder that a study's relative paths start from, and how far it is trusted.

    Attributes
    ----------
    limit
        Seconds that the study gives a task, if it does: a function's first values take no longer.
    files
        What has been named so far: files of specs, what scenes refer to, sources of functions; with
        the names that they have elsewhere too, if they have any.
    """

    folder: Path
    trust: Trust = Trust()
    limit: float | None = None
    files: dict[Path, str] = field(default_factory=dict, compare=False)

    def calls(self, text: str) -> list[Call]:
        """Parse a spec; paths in it start at the folder, in specs inside specs too.

        Raises
        ------
        SpecError
            It cannot be read.
        ConfigError
            A file is outside the folders that may be read.
        """
        return [
            Call(call.name, {key: self._argument(key, v) for key, v in call.arguments.items()})
            for call in parse_chain(text)
        ]

    def one(self, text: str) -> Call:
        """Parse a spec that must not be a chain."""
        calls = self.calls(text)
        if len(calls) != 1:
            raise ConfigError(f"{text!r} chains parts with '|'; only samplers can be chained.")
        return calls[0]

    def component(
        self, registry: Registry, text: str, dims: int | None, wrap: Callable[..., Any] | None
    ) -> Any:
        """Make the component of a spec; `wrap` makes one of a Python function and dims.

        Raises
        ------
        ConfigError
            The spec names a Python function that is not allowed or cannot be imported, or one where
            no function can stand.
        """
        call = self.one(text)
        if call.name != "python":
            return registry.build(call, dims)
        if wrap is None:
            raise ConfigError(f"{text!r}: only integrands can be Python functions.")
        if set(call.arguments) != {"function"}:
            raise ConfigError(f"{text!r}: write python(function='module:function').")
        return wrap(self._function(call.arguments["function"]), dims=2 if dims is None else dims)

    def scene(self, text: str) -> str:
        """A scene's name as it is, or its file, found from the folder."""
        return str(self._argument("scene", text))

    def _function(self, name: object) -> Callable[..., Any]:
        if not isinstance(name, str) or not _FUNCTION.fullmatch(name):
            raise ConfigError(f"python(function={name!r}): write 'module:function'.")
        if name not in self.trust.code:
            raise ConfigError(
                f"The study names the Python function {name!r}, and a study file may not run code: if "
                f"you trust it, allow it by --allow-code {name}."
            )
        module, _, attribute = name.partition(":")
        try:
            found = getattr(importlib.import_module(module), attribute)
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # whatever the code of others does
            raise ConfigError(
                f"The function {name!r} cannot be imported: {explain(error)}"
            ) from error
        if not callable(found):
            raise ConfigError(f"{name!r} is {found!r}, not a function.")
        self.files.update(function_sources(found, module))
        return found  # type: ignore[no-any-return]

    def _argument(self, key: str, value: Any) -> Any:
        if isinstance(value, list | tuple):
            # Only of paths may there be several; the rows of a net's matrices are digits.
            return [self._argument(key if key == "path" else "", item) for item in value]
        if isinstance(value, dict):
            return {k: self._argument(str(k), item) for k, item in value.items()}
        if not isinstance(value, str):
            return value
        if key in _FILES or (key == "scene" and _is_file(value)):
            return str(self._file(value))
        return self._inner(value)

    def _inner(self, text: str) -> str:
        """A string argument: its paths start at the folder if it is a spec."""
        try:
            given = parse_chain(text)
        except McspectraError:
            return text
        found = self.calls(text)
        return text if found == given else " | ".join(map(_written, found))

    def _file(self, path: str) -> Path:
        """The file, found from the folder; links are followed to see where it is.

        A study may not look around on the disk of who runs it.
        """
        if "\0" in path:
            raise ConfigError(f"{path!r} is not the name of a file.")
        file = self.folder / path
        allowed = (self.folder, *self.trust.folders)
        try:
            inside = any(file.resolve().is_relative_to(root.resolve()) for root in allowed)
        except (OSError, RuntimeError):  # a loop of links
            inside = False
        if not inside:
            raise ConfigError(
                f"The file {path!r} is outside the study's folder; move it there, or allow its folder "
                f"by --allow-path {file.parent}."
            )
        self.files.update(dict.fromkeys(with_references(file), ""))
        return file


def _is_file(scene: str) -> bool:
    """Whether a scene is a file rather than a name with parameters."""
    return scene.lower().endswith(".xml") or "/" in scene.partition("(")[0] or "\\" in scene


def _written(call: Call) -> str:
    shown = ", ".join(f"{key}={value!r}" for key, value in call.arguments.items())
    return f"{call.name}({shown})" if shown else call.name
