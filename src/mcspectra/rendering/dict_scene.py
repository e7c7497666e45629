"""Scenes that users give as Mitsuba dictionaries, made hashable so that each is loaded once."""

from __future__ import annotations

import hashlib
from collections.abc import Hashable, Mapping
from typing import Any, final

import numpy as np

from mcspectra.core.errors import ParameterError

__all__ = ["DictScene"]

_DEEPEST = 64  # nested dictionaries; a dictionary that holds itself goes deeper


@final
class DictScene:
    """A Mitsuba scene dictionary as a key of caches: equal if the contents are.

    Parameters
    ----------
    scene
        A dictionary for `mitsuba.load_dict`. Its dictionaries, lists and arrays are copied: changing
        them later changes nothing here. Transforms, bitmaps and arrays compare by their numbers,
        objects that Mitsuba has already built by identity.

    Raises
    ------
    ParameterError
        The root's ``type`` is not ``"scene"``, a key is not a string, or the nesting is too deep.

    Notes
    -----
    It prints as ``dict``. It can be pickled only if it holds no objects of Mitsuba's.
    """

    def __init__(self, scene: Mapping[str, Any]) -> None:
        if scene.get("type") != "scene":
            raise ParameterError(
                f"The root of a scene dictionary has the type {scene.get('type')!r}; "
                "it must be 'scene'."
            )
        self._copy: dict[str, Any] = _copied(scene)
        self._key = _key(self._copy)

    @property
    def contents(self) -> dict[str, Any]:
        """A copy of the dictionary."""
        return dict(_copied(self._copy))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, DictScene) and self._key == other._key

    def __hash__(self) -> int:
        return hash(self._key)

    def __repr__(self) -> str:
        return "dict"


@final
class _Identity:
    """An object as a key by identity; holding it keeps its address from being used again."""

    def __init__(self, target: object) -> None:
        self._target = target

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Identity) and self._target is other._target

    def __hash__(self) -> int:
        return id(self._target)


def _copied(value: Any, depth: int = 0) -> Any:
    if depth > _DEEPEST:
        raise ParameterError(
            f"The scene dictionary is nested more than {_DEEPEST} deep; remove parts that contain themselves."
        )
    if isinstance(value, Mapping):
        return {_checked_name(name): _copied(entry, depth + 1) for name, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_copied(entry, depth + 1) for entry in value]
    return value.copy() if isinstance(value, np.ndarray) else value


def _checked_name(name: object) -> str:
    if not isinstance(name, str):
        raise ParameterError(f"A key of the scene dictionary is {name!r}; it must be a string.")
    return name


def _key(value: Any) -> Hashable:
    # The order of entries is kept: it is that of the lights, which have numbers.
    if isinstance(value, Mapping):
        return "dict", tuple((name, _key(entry)) for name, entry in value.items())
    if isinstance(value, list):
        return "list", tuple(map(_key, value))
    if isinstance(value, str | int | float | bool | None):
        return type(value).__name__, value
    numbers = _numbers(value)
    if numbers is None:
        return _Identity(value)
    digest = hashlib.sha256(np.ascontiguousarray(numbers).tobytes()).hexdigest()
    return type(value).__name__, numbers.shape, str(numbers.dtype), digest


def _numbers(value: Any) -> np.ndarray[Any, Any] | None:
    """Return the numbers of an array, a bitmap or a transform, None for anything else."""
    holder = getattr(value, "matrix", value)
    if not (hasattr(holder, "__array__") or hasattr(holder, "__array_interface__")):
        return None
    numbers = np.asarray(holder)
    return None if numbers.dtype == object else numbers
