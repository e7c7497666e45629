"""Integrands that are written as a formula, such as ``exp(-x**2 - y**2)``, and read as data.

Python's parser reads the text. Its syntax tree is converted once into a tree of NumPy functions.
Only the syntax in the lists below is allowed. Anything else is an error.
No other name is looked up, and no Python code is evaluated.
Numbers are first converted to floats, so ``9**9**9`` is infinite and does not run forever.
"""

from __future__ import annotations

import ast
import itertools
import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, TypeAlias, final

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.display import shown
from mcspectra.core.errors import ParameterError, close_match_hint, point_in_words
from mcspectra.integrands.base import Breaks, Integrand, any_dims

__all__ = ["Formula"]

# Maximum count of all numbers, names, operators and calls in a formula together
MOST_PARTS = 300
_MARK = re.compile(r"\w+|[^\w\s]")
# Maximum number of tokens. One call has a name, brackets, commas and maybe an exponent
_MOST_MARKS = 6 * MOST_PARTS
_PROBES = 4
# Maximum depth of the tree. Reading and evaluation recurse, with three stack frames per level
_MOST_DEPTH = 100

Evaluation: TypeAlias = Callable[[Array], Any]
"""Function that maps points (..., d) to values: an array (...) or a number."""

FUNCTIONS: Mapping[str, tuple[Callable[..., Any], int]] = {
    **{name: (getattr(np, name), 1) for name in (
        "sin", "cos", "tan", "arcsin", "arccos", "arctan", "sinh", "cosh", "tanh", "exp", "log",
        "log2", "log10", "sqrt", "floor", "ceil", "sign", "sinc",
    )},
    **{name: (getattr(np, name), 2) for name in ("hypot", "arctan2")},
    "abs": (np.abs, 1),
    "min": (np.minimum, 2),
    "max": (np.maximum, 2),
    "where": (np.where, 3),
}  # fmt: skip
"""Functions by name, each with the number of its arguments."""

_CONSTANTS = {"pi": math.pi, "e": math.e}
_AXES = "xyz"
_OPERATORS: Mapping[type, Callable[..., Any]] = {
    ast.Add: np.add, ast.Sub: np.subtract, ast.Mult: np.multiply, ast.Div: np.divide,
    ast.Pow: np.power, ast.Mod: np.mod, ast.UAdd: np.positive, ast.USub: np.negative,
    ast.Lt: np.less, ast.LtE: np.less_equal, ast.Gt: np.greater, ast.GtE: np.greater_equal,
}  # fmt: skip


@final
@dataclass(frozen=True, kw_only=True)
class Formula(Integrand):
    """A formula of the coordinates, which is read as data.

    An example is ``exp(-x**2 - y**2)``. A formula may contain numbers, pi and e.
    The coordinates are x, y, z (or x0, x1, …).
    A formula may also contain the operators + - * / ** %, comparisons and functions.
    A comparison is 1 where it is true, and 0 elsewhere.
    The functions are sin, cos, tan, arcsin, arccos, arctan, arctan2, sinh, cosh, tanh, exp, log,
    log2, log10, sqrt, hypot, abs, sign, sinc, floor, ceil, min, max and where.
    Any other name is an error, and nothing is run as Python.

    Parameters
    ----------
    expression
        The formula, with at most 300 parts.
    dims
        Number of dims.

    Raises
    ------
    ParameterError
        If the text is not a formula as above, or names a coordinate that `dims` does not include.
        If the value is not finite at four test points inside the cube.

    Examples
    --------
    >>> f = Formula(expression="where(x < 0.25, 4 * x, y)", dims=2)
    >>> f([[0.125, 0.0], [0.5, 0.75]])
    array([0.5 , 0.75])
    """

    expression: str
    dims: int = any_dims()

    def _check(self) -> None:
        given: object = self.expression
        if not isinstance(given, str) or not given.strip():
            raise ParameterError(
                f"The formula is {shown(given)}; give text such as 'exp(-x**2 - y**2)'."
            )
        # Evaluate at points of an additive recurrence, which avoid planes such as x = y and x = ½
        steps = np.sqrt(np.arange(self.dims) + 2.5)
        self._evaluate(np.arange(1, _PROBES + 1)[:, None] * steps % 1.0)

    @property
    def breaks(self) -> Breaks:
        """Positions at which the formula compares a coordinate with a number."""
        return _compiled(self.expression, self.dims)[1]

    def _evaluate(self, x: Array) -> Array:
        with np.errstate(all="ignore"):
            found = _compiled(self.expression, self.dims)[0](x)
        values = np.array(np.broadcast_to(found, x.shape[:-1]), np.float64)
        finite = np.isfinite(values)
        if not finite.all():
            where = point_in_words(x[~finite][0])
            raise ParameterError(
                f"{self.spec} is NaN or infinite, for example at {where}; it must be finite "
                "wherever it is evaluated."
            )
        return values


@lru_cache(64)
def _compiled(text: str, dims: int) -> tuple[Evaluation, Breaks]:
    """Read a formula. Return its function, and the numbers with which it compares coordinates."""
    # Python's parser needs stack space for each token. A million tokens may end the process
    marks = sum(1 for _ in itertools.islice(_MARK.finditer(text), _MOST_MARKS + 1))
    if marks > _MOST_MARKS:
        raise ParameterError(
            f"The formula has more than {MOST_PARTS} parts; give at most {MOST_PARTS} parts on "
            f"{_MOST_DEPTH} levels."
        )
    try:
        tree = ast.parse(text.strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        shown = text if len(text) <= 60 else f"{text[:60]}…"
        raise ParameterError(
            f"The formula {shown!r} cannot be read; write it as in Python, "
            "such as 'exp(-x**2 - y**2)', with * for products."
        ) from None

    # Count parts and levels without recursion. Operators and contexts do not count as parts
    level: list[ast.AST] = [tree]
    parts = depth = 0
    kinds = ast.expr | ast.comprehension | ast.keyword
    while level:
        parts, depth = parts + len(level), depth + 1
        children = itertools.chain.from_iterable(map(ast.iter_child_nodes, level))
        level = [child for child in children if isinstance(child, kinds)]
    if parts > MOST_PARTS or depth > _MOST_DEPTH:
        raise ParameterError(
            f"The formula has {parts} parts on {depth} levels; give at most {MOST_PARTS} parts "
            f"on {_MOST_DEPTH} levels."
        )

    reader = _TreeReader(dims)
    evaluate = reader.read(tree)
    return evaluate, tuple(tuple(sorted(places)) for places in reader.breaks)


class _TreeReader:
    """Converts a syntax tree into a function that evaluates it, and collects `breaks`."""

    def __init__(self, dims: int) -> None:
        self.dims = dims
        self.breaks: list[set[float]] = [set() for _ in range(dims)]

    def read(self, node: ast.expr) -> Evaluation:
        match node:
            case ast.Constant():
                return _number(node.value)
            case ast.Name():
                return self._name(node.id)
            case ast.UnaryOp():
                return _applied(_operator(node.op), self.read(node.operand))
            case ast.BinOp():
                return _applied(_operator(node.op), self.read(node.left), self.read(node.right))
            case ast.Compare():
                return self._comparison(node)
            case ast.Call():
                return self._call(node)
        raise ParameterError(
            f"The formula contains {ast.unparse(node)[:40]!r}; use numbers, coordinates, "
            "+ - * / ** %, comparisons and functions only."
        )

    def _name(self, name: str) -> Evaluation:
        if name in _CONSTANTS:
            return _number(_CONSTANTS[name])
        axis = self._axis(name)
        return lambda x: x[..., axis]

    def _axis(self, name: str) -> int:
        known = {f"x{i}": i for i in range(self.dims)}
        known |= {letter: i for i, letter in enumerate(_AXES[: self.dims])}
        if name in known:
            return known[name]
        hint, close = close_match_hint(name, [*known, *_CONSTANTS])
        few = self.dims <= len(_AXES)
        names = _AXES[: self.dims] if few else ("x0", "…", f"x{self.dims - 1}")
        raise ParameterError(
            f"A formula in {self.dims} dims has no {name[:40]!r}."
            + (hint if close else f" Its coordinates are {', '.join(names)}.")
        )

    def _comparison(self, node: ast.Compare) -> Evaluation:
        """Return 1 where all comparisons in ``a < b < c`` are true, else 0."""
        sides = [node.left, *node.comparators]
        for a, b in itertools.pairwise(sides):
            self._note_break(a, b)
            self._note_break(b, a)
        values = [self.read(side) for side in sides]
        pairs = zip(node.ops, values, values[1:], strict=False)
        tests = [_applied(_operator(op), a, b) for op, a, b in pairs]
        return lambda x: np.multiply.reduce([np.asarray(test(x), np.float64) for test in tests])

    def _note_break(self, side: ast.expr, other: ast.expr) -> None:
        if isinstance(side, ast.Name) and isinstance(other, ast.Constant):
            place = float(_number(other.value)(np.empty(0)))
            if side.id not in _CONSTANTS and 0.0 < place < 1.0:
                self.breaks[self._axis(side.id)].add(place)

    def _call(self, node: ast.Call) -> Evaluation:
        name = node.func.id if isinstance(node.func, ast.Name) else ""
        if name not in FUNCTIONS:
            called = ast.unparse(node.func)[:40]
            hint, close = close_match_hint(called, FUNCTIONS)
            known = hint if close else f" There are {', '.join(FUNCTIONS)}."
            raise ParameterError(f"A formula has no function {shown(called)}.{known}")
        function, arity = FUNCTIONS[name]
        starred = any(isinstance(each, ast.Starred) for each in node.args)
        if len(node.args) != arity or node.keywords or starred:
            raise ParameterError(f"{name} in a formula takes {arity} positional argument(s).")
        return _applied(function, *(self.read(each) for each in node.args))


def _number(value: object) -> Evaluation:
    """Return a constant as a float. Python's integers have no limit, but floats do."""
    try:
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise TypeError
        number = np.float64(value)
    except (TypeError, OverflowError):
        shown = repr(value) if not isinstance(value, int) else "a number that is too large"
        raise ParameterError(f"The formula contains {shown[:40]}; use real numbers.") from None
    return lambda _: number


def _operator(node: ast.AST) -> Callable[..., Any]:
    if type(node) not in _OPERATORS:
        raise ParameterError(
            f"The formula contains the operator {type(node).__name__}; use + - * / ** % < <= > >=."
        )
    return _OPERATORS[type(node)]


def _applied(function: Callable[..., Any], *arguments: Evaluation) -> Evaluation:
    return lambda x: function(*(each(x) for each in arguments))
