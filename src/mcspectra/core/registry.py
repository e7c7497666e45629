"""Registries: they map names in spec strings to classes, which are loaded on first use.

Built-in classes are given as text, ``"module:Class"``, so that listing names imports nothing.
Other packages add names by the entry points in `Registry.group`.
If a built-in class has the same name, it has priority.
"""

from __future__ import annotations

import functools
import importlib
import inspect
import sys
from collections.abc import Iterator, Mapping
from importlib.metadata import entry_points
from types import MappingProxyType
from typing import Any

from mcspectra.core.display import counted, needed, shown
from mcspectra.core.errors import MissingDependency, ParameterError, UnknownName, reason_of
from mcspectra.core.errors import close_match_hint as hint
from mcspectra.core.spec import Call, Component, kebab_case

__all__ = ["DEFAULT_DIMS", "Registry", "classes_of", "optional_package"]

DEFAULT_DIMS = 2
"""Default number of dims for a spec string. The default is 2 because images have two dims."""


class Registry(Mapping[str, str]):
    """Registry of the names of one kind of component, such as samplers.

    Parameters
    ----------
    kind
        Name of this kind of component in messages, e.g. ``"sampler"``.
    group
        Entry-point group in which other packages register ``name = "module:Class"``.
    builtin
        Mapping from the names of built-in classes to ``"module:Class"``.
    base
        Base class of all registered classes. It is None if functions are registered instead.
    """

    def __init__(
        self,
        kind: str,
        group: str,
        builtin: Mapping[str, str],
        *,
        base: type | None = Component,
    ) -> None:
        self.base = base
        self.kind = kind
        self.group = group
        self._builtin = MappingProxyType(dict(sorted(builtin.items())))

    def __getitem__(self, name: str) -> str:
        return self._targets()[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._targets())

    def __len__(self) -> int:
        return len(self._targets())

    def load(self, name: str) -> type[Any]:
        """Return the class that is registered under `name`.

        Raises
        ------
        UnknownName
            If the name is not registered. The message suggests similar names.
        MissingDependency
            If the module needs a package that is not installed, or that is broken.
        """
        target = self._builtin.get(name) or self._targets().get(name)
        if target is None:
            listing = f"mcspectra list {self.group.rpartition('.')[2]}"
            offer, close = hint(name, self._targets(), listing)
            raise UnknownName(f"There is no {self.kind} called {shown(name)}.{offer}", close)
        module, _, attribute = target.partition(":")
        try:
            found: Any = getattr(importlib.import_module(module), attribute)
        except MissingDependency:
            raise
        except (Exception, SystemExit) as error:  # code of other packages may raise anything
            raise MissingDependency(
                f"The {self.kind} {shown(name)} ({target}) cannot be loaded: {reason_of(error)}."
            ) from error
        known = isinstance(found, type) and issubclass(found, self.base or object)
        if not (known if self.base else callable(found)):
            raise MissingDependency(
                f"The {self.kind} {shown(name)} ({target}) is {shown(found)}, not a class that "
                "makes one; fix the package that registers it."
            )
        return found  # type: ignore[no-any-return]

    def build(self, call: Call, dims: int | None = None) -> Any:
        """Create the component that `call` describes.

        `dims` is the number of dims in the context. A ``dims=`` in the call must agree with it.
        """
        cls = self.load(call.name)
        allowed = inspect.signature(cls).parameters
        # A parameter such as radius has the field radius_ if the plain name is already used
        arguments = {
            f"{key}_" if f"{key}_" in allowed else key: value
            for key, value in call.arguments.items()
        }
        for key in arguments:
            if key not in allowed:
                taken = [p.rstrip("_") for p in allowed]
                offer, close = hint(key, taken)
                takes = f"it takes {', '.join(taken)}" if taken else "it takes no parameters"
                sentence = f"{call.name} has no parameter {shown(key)}; {takes}."
                raise ParameterError(sentence + (offer if close else ""))
        if dims is not None:
            given = arguments.setdefault("dims", dims) if "dims" in allowed else dims
            if given != dims:
                raise ParameterError(f"{call.name} has dims={given}, but {needed(dims, 'dim')}.")
        missing = [
            p.name.rstrip("_")
            for p in allowed.values()
            if p.default is p.empty and p.kind is p.KEYWORD_ONLY and p.name not in arguments
        ]
        if missing:
            raise ParameterError(f"{call.name} needs {', '.join(missing)}.")
        component = cls(**arguments)
        if dims is not None and getattr(component, "dims", dims) != dims:
            raise ParameterError(
                f"{call.name} is for {counted(component.dims, 'dim')}, but {needed(dims, 'dim')}."
            )
        return component

    def _targets(self) -> dict[str, str]:
        extra = _registered(self.group, tuple(sys.path))
        return dict(sorted({**extra, **self._builtin}.items()))


def classes_of(modules: Mapping[str, str]) -> dict[str, str]:
    """Return names of this package's classes, mapped to ``"module:Class"``, for a registry.

    Parameters
    ----------
    modules
        Classes of each module, separated by blanks.
        By default, the name is that of the class in kebab case, as for ``RandomRotation``.
        A different name is written explicitly, as in ``disk=DiskDensity``.
    """
    found = {}
    for module, classes in modules.items():
        for each in classes.split():
            name, _, own = each.rpartition("=")
            found[name or kebab_case(own)] = f"mcspectra.{module}:{own}"
    return found


def optional_package(name: str, extra: str, need: str) -> Any:
    """Load an optional package, or one of its modules. Return the package.

    Parameters
    ----------
    name, extra
        Name of the package, such as ``"zarr.storage"``, and the extra that installs it.
    need
        Beginning of the error message, such as ``"Stores .zarr need"``.

    Raises
    ------
    MissingDependency
        If the package is not installed, or cannot be loaded.
    """
    package = name.partition(".")[0]
    try:
        importlib.import_module(name)
    except (ImportError, OSError) as error:
        missing = getattr(error, "name", None) or ""
        install = f"install it with: pip install 'mcspectra[{extra}]'"
        if not (isinstance(error, ModuleNotFoundError) and missing.partition(".")[0] == package):
            install = f"it cannot be loaded: {reason_of(error)}; reinstall it."
        raise MissingDependency(f"{need} the package {package}; {install}") from error
    return sys.modules[package]


@functools.lru_cache(maxsize=64)
def _registered(group: str, path: tuple[str, ...]) -> dict[str, str]:  # noqa: ARG001
    """Return names that other packages register. The search takes ten milliseconds per path."""
    return {each.name: each.value for each in entry_points(group=group)}
