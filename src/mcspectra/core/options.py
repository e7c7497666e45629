"""Options of analyses. Each is declared once, as an annotation in a struct, and is checked here.

The annotation of a field (`msgspec.Meta`) holds the meaning and the limits of its option.
The field holds the option's default.
Python functions, study files, commands, the explorer and the docs use these annotations.
Python and study files check values by `Option.check`.
The command line and forms convert texts by `Option.read`.
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Annotated, Any, Literal, final

import msgspec
import numpy as np
from msgspec import Meta, inspect

from mcspectra.core.checks import as_choice, as_integer, as_real
from mcspectra.core.display import counted, shown
from mcspectra.core.errors import Parameter, ParameterError
from mcspectra.core.parallel import MAX_REALIZATIONS

__all__ = [
    "BANDS",
    "BASIS",
    "COUNT",
    "COUNTS",
    "ENGINE",
    "EPS",
    "FIT_LAST",
    "HALF_WIDTH",
    "REALIZATIONS",
    "SETS",
    "SPACE",
    "AnyText",
    "Counts",
    "Evaluations",
    "Option",
    "Positive",
    "Text",
    "Window",
    "checked",
    "options_of",
    "whole_number",
]

# Messages do not mention limits above this number, which only keep values within 64 bits
_NO_LIMIT = 2**31
_LISTS = (inspect.VarTupleType, inspect.TupleType)
_SORTS: Mapping[type, Any] = {  # Python types that fit each type of option
    **dict.fromkeys((inspect.IntType, inspect.FloatType), (int, float, np.number)),
    **dict.fromkeys((inspect.StrType, inspect.LiteralType), str),
    **dict.fromkeys(_LISTS, (Sequence, np.ndarray)),
}

Positive = Annotated[int, Meta(ge=1, le=2**62)]
Text = Annotated[str, Meta(min_length=1, max_length=20_000)]
AnyText = Annotated[str, Meta(min_length=0, max_length=20_000)]  # a later check refuses ""
Counts = Annotated[tuple[Positive, ...], Meta(min_length=1, max_length=10_000)]
Window = Annotated[int, Meta(ge=2)] | Literal["auto"] | None

Evaluations = Annotated[
    Positive | None,
    Meta(
        description="Most evaluations of the integrand; an analysis that takes more is refused.",
        extra={"metavar": "N"},
    ),
]

# Options that several analyses use. The entries `flag` and `metavar` describe the command line.
# The entry `python` marks options that also accept Python objects, which the analysis checks
COUNT = Meta(
    ge=1, le=2**62, description="Points of each technique.", extra={"flag": "-n", "metavar": "N"}
)
COUNTS = Meta(
    description="Numbers of points n, ascending.",
    extra={"flag": "-n", "metavar": "N,N,…", "ascending": True},
)
REALIZATIONS = Meta(
    ge=2,
    le=MAX_REALIZATIONS,
    description="Independent realizations at each count.",
    extra={"flag": "-m", "metavar": "R"},
)
SETS = Meta(
    ge=1,
    le=MAX_REALIZATIONS,
    description="Independent point sets; 2 or more for standard errors.",
    extra={"flag": "-m", "metavar": "R"},
)
HALF_WIDTH = Meta(
    ge=0,
    le=2**31,
    description="Largest frequency along each axis.",
    extra={"metavar": "K", "unit": "cycles per unit"},
)
BASIS = Meta(
    description="fourier, cosine, walsh, haar, or auto: the basis that fits the randomization.",
    extra={"choices": ("fourier", "cosine", "walsh", "haar", "auto")},
)
SPACE = Meta(
    description="domain, or primary: the unit cube of the points; by default the domain, if there "
    "is one."
)
BANDS = Meta(
    description="radial, dyadic, anova or wedge.",
    extra={"choices": ("radial", "dyadic", "anova", "wedge"), "python": True},
)
FIT_LAST = Meta(
    description='Number of the last counts that the rate is fitted to; all by default; "auto": as '
    "many "
    "as lie on a line.",
    extra={"metavar": "K"},
)
ENGINE = Meta(
    description="How to compute the Fourier transforms: auto, nufft or direct.",
    extra={"choices": ("auto", "nufft", "direct")},
)
EPS = Meta(ge=1e-14, le=0.1, description="Relative accuracy of the transforms.")


@final
@dataclass(frozen=True)
class Option:
    """An option of a struct.

    Attributes
    ----------
    name
        Name in Python and in study files.
    kind
        Type of the value, with its smallest and largest values, as `msgspec.inspect` returns it.
    default
        Default value, or `msgspec.NODEFAULT` if the option is required.
    meaning
        Description of the option in one sentence.
    extra
        Further entries of the annotation: ``flag``, ``metavar``, ``choices``, ``unit``, ``help``.
        The entry ``help`` describes a flag whose name differs from the name of the option.
    """

    name: str
    kind: inspect.Type
    default: Any
    meaning: str
    extra: dict[str, Any]

    @property
    def required(self) -> bool:
        """Whether the option has no default."""
        return self.default is msgspec.NODEFAULT

    @property
    def flag(self) -> str:
        """The option on the command line, such as ``--half-width``."""
        return "--" + self.name.replace("_", "-")

    @property
    def choices(self) -> tuple[str, ...]:
        """Allowed texts of the option. Empty if any text is allowed, or this is not a text."""
        return _words(_kinds(self.kind)) or tuple(self.extra.get("choices", ()))

    @property
    def item_choices(self) -> tuple[str, ...]:
        """Allowed texts of list items. Empty if any text is allowed, or this is not a list."""
        return _words(self._items)

    @property
    def is_flag(self) -> bool:
        """Whether the option is true or false."""
        return any(isinstance(kind, inspect.BoolType) for kind in _kinds(self.kind))

    @property
    def lists_texts(self) -> bool:
        """Whether the option is a list of texts, each of which may contain commas."""
        texts = inspect.StrType | inspect.LiteralType
        return any(isinstance(kind, texts) for kind in self._items)

    @property
    def _items(self) -> list[inspect.Type]:
        """Types of the items of a list, without their limits. Empty if the option is not a list."""
        lists = [each for each in _kinds(self.kind) if isinstance(each, _LISTS)]
        return [item for each in lists for item in _kinds(_item(each))]

    def check(self, value: Any, label: str | None = None, *, from_file: bool = False) -> Any:
        """Return the checked and converted value.

        Parameters
        ----------
        value
            The value to check.
        label
            Subject of the error message. The default is the name of the option.
        from_file
            Whether the value comes from a file. Such a value cannot be an array.
            Messages about values from files give the index of list items, from 0.

        Raises
        ------
        ParameterError
            If the type is wrong or a limit is exceeded.
        """
        label = label or self.name
        if self.extra.get("python") and not (from_file or isinstance(value, str)):
            return value
        if value is None and any(isinstance(k, inspect.NoneType) for k in _kinds(self.kind)):
            return None
        if self.extra.get("choices"):
            return as_choice(label, value, self.choices)
        clean = _clean(label, self.kind, value, from_file)
        several = self.extra.get("ascending") and isinstance(clean, tuple)
        if several and any(b <= a for a, b in itertools.pairwise(clean)):
            raise ParameterError(
                Parameter(label), f" is {list(clean)}; give ascending numbers of points."
            )
        return clean

    def read(self, text: str, label: str | None = None) -> Any:
        """Return the converted value of a text from the command line or a form.

        Raises
        ------
        ParameterError
            If `check` rejects the value.
        """
        return self.check(_read(self.kind, text), label or self.flag)


@functools.cache
def options_of(struct: Any) -> tuple[Option, ...]:
    """Return the options of a struct in the order of its fields."""
    kind = inspect.type_info(struct)
    assert isinstance(kind, inspect.StructType)
    found = []
    for field in kind.fields:
        about, extra = _annotation(field.type)
        given = field.default
        # Some fields have a function that makes the default value
        if field.default_factory is not msgspec.NODEFAULT:
            given = field.default_factory()
        found.append(Option(field.name, field.type, given, about, extra))
    return tuple(found)


def checked(struct: Any) -> Any:
    """Return a struct after a check of its options.

    For options that are given in Python, this is the only check.

    Raises
    ------
    ParameterError
        If an option has the wrong type or exceeds its limits.
    """
    options = options_of(type(struct))  # type: ignore[arg-type]
    clean = {each.name: each.check(getattr(struct, each.name)) for each in options}
    return msgspec.structs.replace(struct, **clean)


def whole_number(text: str) -> int | float | str:
    """Return the number in a text, such as 64 or 1e3. If it is not finite, return the text.

    Later, `as_integer` checks whether the number is whole: it accepts 1000.0 and rejects 1.5.
    """
    for kind in (int, float):
        with suppress(ValueError):
            number: int | float = kind(text)
            return number if math.isfinite(number) else text
    return text


def _annotation(kind: inspect.Type) -> tuple[str, dict[str, Any]]:
    """Return the description and `extra` of an annotated type. Outer annotations have priority."""
    if not isinstance(kind, inspect.Metadata):
        return "", {}
    own = dict(kind.extra or {})
    schema = kind.extra_json_schema or {}
    inner, further = _annotation(kind.type)
    return schema.get("description", inner), {**further, **own}


def _kinds(kind: inspect.Type) -> list[inspect.Type]:
    """Return the types of a union or an annotated type, without annotations."""
    if isinstance(kind, inspect.Metadata):
        return _kinds(kind.type)
    if isinstance(kind, inspect.UnionType):
        return [each for part in kind.types for each in _kinds(part)]
    return [kind]


def _words(kinds: list[inspect.Type]) -> tuple[str, ...]:
    literal = [kind for kind in kinds if isinstance(kind, inspect.LiteralType)]
    return tuple(v for kind in literal for v in kind.values if isinstance(v, str))


def _item(kind: inspect.VarTupleType | inspect.TupleType) -> inspect.Type:
    """Return the type of the items of a list."""
    return kind.item_type if isinstance(kind, inspect.VarTupleType) else kind.item_types[0]


def _clean(label: str, kind: inspect.Type, value: Any, from_file: bool) -> Any:
    kinds = [each for each in _kinds(kind) if not isinstance(each, inspect.NoneType)]
    words = _words(kinds)
    if isinstance(value, str) and value in words:
        return value
    if len(kinds) > 1 and words:
        kinds = [each for each in kinds if not isinstance(each, inspect.LiteralType)]
        if isinstance(value, str):
            wanted = "a number"
            if isinstance(kinds[0], inspect.IntType):
                from_ = kinds[0].ge
                wanted = "a whole number" + ("" if from_ is None else f" of at least {from_}")
            offer = " or ".join(map(repr, words))
            raise ParameterError(
                Parameter(label), f" is {shown(value)}; give {wanted}, or {offer}."
            )

    # If several types are allowed, choose the type of the value, even if the value exceeds limits
    fits = [each for each in kinds if isinstance(value, _SORTS.get(type(each), ()))]
    if isinstance(value, str):  # a string is a sequence, but not a list
        fits = [each for each in fits if not isinstance(each, _LISTS)]
    fitting = (fits or kinds)[0]
    match fitting:
        case inspect.IntType(ge=least, le=most):
            limit = None if most is None or most >= _NO_LIMIT else most
            least = -(2**63) if least is None else least
            number = as_integer(label, value, least=least, most=limit)
            return number if most is None else as_integer(label, value, least=least, most=most)
        case inspect.FloatType(gt=above, ge=least, lt=below, le=most):
            return as_real(label, value, above=above, least=least, below=below, most=most)
        case inspect.BoolType():
            if not isinstance(value, bool | np.bool_):
                raise ParameterError(Parameter(label), f" is {shown(value)}; give True or False.")
            return bool(value)
        case inspect.LiteralType(values=allowed):
            return as_choice(label, value, tuple(map(str, allowed)))
        case inspect.StrType(min_length=least, max_length=most):
            if not isinstance(value, str) or not (value or least == 0):
                raise ParameterError(Parameter(label), f" is {shown(value)}; give a text.")
            if most is not None and len(value) > most:
                raise ParameterError(
                    Parameter(label), f" has {len(value)} characters; {most} are allowed."
                )
            return value
        case inspect.VarTupleType() | inspect.TupleType():
            several = isinstance(value, Sequence) or (isinstance(value, np.ndarray) and value.ndim)
            if not several or isinstance(value, str | bytes):
                raise ParameterError(Parameter(label), f" is {shown(value)}; give one flat list.")
            # Check the length first, because a range may be very long
            size = len(value)
            if isinstance(fitting, inspect.TupleType) and size != len(fitting.item_types):
                raise ParameterError(
                    Parameter(label),
                    f" has {counted(size, 'value')}; give {len(fitting.item_types)}.",
                )
            longest = getattr(fitting, "max_length", None) or _NO_LIMIT
            if size > longest:
                raise ParameterError(
                    Parameter(label), f" has {counted(size, 'value')}; {longest} are allowed."
                )
            if any(np.ndim(each) > 0 for each in value if not isinstance(each, str)):
                raise ParameterError(Parameter(label), f" is {shown(value)}; give one flat list.")
            if not size:
                raise ParameterError(Parameter(label), " has no values; give one or more.")
            return tuple(
                _clean(f"{label}[{i}]" if from_file else label, _item(fitting), each, from_file)
                for i, each in enumerate(value)
            )
    return value


def _read(kind: inspect.Type, text: str) -> Any:
    """Convert a text to the most specific type that can read it, or return the text itself."""
    for each in _kinds(kind):
        if isinstance(each, _LISTS):
            return tuple(_read(_item(each), part.strip()) for part in text.split(","))
        if isinstance(each, inspect.IntType):
            number = whole_number(text)
            if not isinstance(number, str):
                return number
        if isinstance(each, inspect.FloatType):
            with suppress(ValueError):
                return float(text)
    return text
