"""Errors: one base class, built-in parents, extra data; hints suggest similar names."""

import builtins
import pickle
from pathlib import Path

import pytest

from mcspectra.core import errors
from mcspectra.core.errors import (
    CountError,
    Function,
    McspectraError,
    NotPowerOfTwoWarning,
    Parameter,
    ParameterError,
    UnknownName,
    close_match_hint,
)

PUBLIC = [getattr(errors, name) for name in errors.__all__]
CLASSES = [each for each in PUBLIC if isinstance(each, type) and issubclass(each, Exception)]
ERRORS = [cls for cls in CLASSES if not issubclass(cls, Warning)]


@pytest.mark.parametrize("cls", ERRORS)
def test_every_error_has_one_root_and_a_built_in_parent(cls):
    assert issubclass(cls, McspectraError)
    if cls is not McspectraError:
        parents = [base for base in cls.__mro__ if base.__module__ == builtins.__name__]
        assert len(parents) > 3, "only Exception, BaseException and object"
    assert str(cls("What was given.")) == "What was given."


def test_errors_about_values_are_value_errors():
    values = ["ParameterError", "DomainError", "CountError", "DensityError", "SpecError"]
    values += ["UnknownName", "ConfigError", "FileFormatError"]
    assert all(issubclass(getattr(errors, name), ValueError) for name in values)
    assert issubclass(errors.NoClosedForm, NotImplementedError)
    assert issubclass(errors.MissingDependency, ImportError)


def test_warnings_are_user_warnings():
    assert [cls for cls in CLASSES if cls not in ERRORS]
    assert all(issubclass(cls, UserWarning) for cls in CLASSES if cls not in ERRORS)


def test_errors_carry_data():
    assert CountError("No.", (16, 25)).nearest == (16, 25)
    assert CountError("No.").nearest == ()
    assert UnknownName("No.", ("jittered",)).close == ("jittered",)
    assert UnknownName("No.").close == ()


def test_a_front_end_writes_options_and_functions_its_own_way():
    inner = ParameterError(Parameter("half_width"), " is 3; use ", Function("convergence"), ".")
    error = CountError(inner)
    wrapped = ParameterError(error, " Or ", Parameter("engine", "direct"), ".")
    for each in (wrapped, pickle.loads(pickle.dumps(wrapped))):
        assert str(each) == "half_width is 3; use convergence. Or engine='direct'."
        words = each.sentence(lambda part: f"<{part.name}>")
        assert words == "<half_width> is 3; use <convergence>. Or <engine>."


def test_everything_is_documented():
    assert all((cls.__doc__ or "").strip().endswith(".") for cls in CLASSES)


@pytest.mark.parametrize("depth", [1, 2, 7])
def test_warnings_point_at_the_line_that_called_the_package(depth):
    source = """
def inner(depth):
    return inner(depth - 1) if depth > 1 else warn("As given.", NotPowerOfTwoWarning)
"""
    inside = {"warn": errors.warn, "NotPowerOfTwoWarning": NotPowerOfTwoWarning}
    file = Path(errors.__file__).with_name("inner.py")
    exec(compile(source, file, "exec"), inside)  # noqa: S102
    with pytest.warns(NotPowerOfTwoWarning, match=r"^As given\.$") as caught:
        inside["inner"](depth)
    line = test_warnings_point_at_the_line_that_called_the_package.__code__.co_firstlineno
    assert [w.filename for w in caught] == [__file__]
    assert 0 < caught[0].lineno - line < 15


def test_warnings_of_files_next_to_the_package_keep_their_line():
    with pytest.warns(UserWarning, match="here") as caught:
        errors.warn("here", UserWarning)
    assert [w.filename for w in caught] == [__file__]


NAMES = ["halton", "jittered", "multi-jittered", "sobol"]


@pytest.mark.parametrize(
    ("given", "close"),
    [
        ("jiterd", ("jittered", "multi-jittered")),
        ("jitter", ("jittered", "multi-jittered")),
        ("multijittered", ("multi-jittered", "jittered")),
        ("sobl", ("sobol",)),
        ("", ()),
        ("zzz", ()),
    ],
)
def test_close_matches(given, close):
    hint, found = close_match_hint(given, NAMES)
    assert found == close
    assert hint.startswith(" Did you mean") == bool(close)
    assert all(repr(name) in hint for name in close)


def test_hints_list_few_names_and_count_many():
    hint, close = close_match_hint("zzz", reversed(NAMES))
    assert (hint, close) == (" Allowed: halton, jittered, multi-jittered, sobol.", ())
    hint, close = close_match_hint("zzz", [f"name-{i:02}" for i in range(40)])
    assert (hint, close) == (" There are 40 names.", ())
    hint, _ = close_match_hint(
        "zzz", [f"name-{i:02}" for i in range(40)], "mcspectra list samplers"
    )
    assert hint == " There are 40 names; 'mcspectra list samplers' shows them."


def test_reasons_are_one_line_without_a_full_stop():
    assert errors.reason_of(ValueError("two\n  lines. ")) == "two lines"
    assert errors.reason_of(KeyError()) == "KeyError"
    assert errors.reason_of(ValueError("long" * 100), 6) == "longlo"
