"""Registries: names in spec strings to classes, loaded when first asked for.

Built-in names are ``"module:Class"`` strings, so that nothing is imported to know them. Other
packages add names by the entry points in `Registry.group`. A built-in name always wins.
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
"""Number of dims of a spec string when neither it nor its surroundings say: pictures are 2-D."""


class Registry(Mapping[str, str]):
    """Names of one kind of component.

    Parameters
    ----------
    kind
        What messages call the component, e.g. ``"sampler"``.
    group
        Entry-point group in which other packages register ``name = "module:Class"``.
    builtin
        Name to ``"module:Class"``.
    base
        Class that what is registered derives from; None of functions that make it.
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
        """Return the class behind `name`.

        Raises
        ------
        UnknownName
            Nobody registered the name; the message offers close ones.
        MissingDependency
            The module needs a package that is not installed, or is broken.
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
        except (Exception, SystemExit) as error:  # whatever the code of others does
            raise MissingDependency(
                f"The {self.kind} {shown(name)} ({target}) cannot be loaded: {reason_of(error)}."
            ) from error
        known = isinstance(found, type) and issubclass(found, self.base or object)
        if not (known if self.base else callable(found)):
            raise MissingDependency(
                f"The {self.kind} {shown(name)} ({target}) is {shown(found)}, not a class that makes one; "
                "mend the package that registers it."
            )
        return found  # type: ignore[no-any-return]

    def build(self, call: Call, dims: int | None = None) -> Any:
        """Make the component that `call` describes.

        `dims` is what the surroundings ask for; a ``dims=`` in the call must agree with it.
        """
        cls = self.load(call.name)
        allowed = inspect.signature(cls).parameters
        # Specs say radius=0.7 where Python's field is radius_, its name being taken
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
                raise ParameterError(f"{call.name} says dims={given}, but {needed(dims, 'dim')}.")
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
    """Names of classes of this package, each to its ``"module:Class"``, for a registry.

    Parameters
    ----------
    modules
        For each module the classes that it adds, blanks between, whose names are their own in kebab
        case: ``RandomRotation``, or else are given with them: ``disk=DiskDensity``.
    """
    found = {}
    for module, classes in modules.items():
        for each in classes.split():
            name, _, own = each.rpartition("=")
            found[name or kebab_case(own)] = f"mcspectra.{module}:{own}"
    return found


def optional_package(name: str, extra: str, need: str) -> Any:
    """Load a package, or a module of it, that not everybody has installed; return the package.

    Parameters
    ----------
    name, extra
        Such as ``"zarr.storage"``, and the extra of mcspectra that installs it.
    need
        Beginning of the sentence, such as ``"Stores .zarr need"``.

    Raises
    ------
    MissingDependency
        It is not installed, or cannot be loaded.
    """
    package = name.partition(".")[0]
    try:
        importlib.import_module(name)
    except (ImportError, OSError) as error:
        missing = getattr(error, "name", None) or ""
        install = f"install it with: pip install 'mcspectra[{extra}]'"
        if not (isinstance(error, ModuleNotFoundError) and missing.partition(".")[0] == package):
            install = f"it cannot be loaded: {reason_of(error)}; mend its installation."
        raise MissingDependency(f"{need} the package {package}; {install}") from error
    return sys.modules[package]


@functools.lru_cache(maxsize=64)
def _registered(group: str, path: tuple[str, ...]) -> dict[str, str]:  # noqa: ARG001
    """What other packages register: looked up once for a `sys.path`, in ten milliseconds."""
    return {each.name: each.value for each in entry_points(group=group)}
