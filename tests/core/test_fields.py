"""Fields that check their values, as components of all types declare them."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest

from mcspectra.core.errors import ParameterError
from mcspectra.core.fields import checked, choice, flag, real, settle, whole
from mcspectra.core.spec import Component


@dataclass(frozen=True, kw_only=True)
class Waves(Component):
    name: ClassVar[str] = "waves"
    count: int = whole(least=1, most=9)
    length: float = real(1.0, above=0.0)
    phase: float | None = real(None, least=0.0)
    kind: str = choice("sine", "square")
    steps_: int = whole(4, least=1)
    closed: bool = flag(default=False)
    axis: int = checked(lambda _, given, dims: given % dims, 0, using="dims")
    dims: int = whole(2, least=1)
    total: ClassVar[float]

    def _check(self):
        settle(self, total=self.count * self.length)


def test_fields_hold_what_their_checks_return():
    made = Waves(count=2.0, length=np.float32(3), axis=5, dims=3.0)
    assert made == Waves(count=2, length=3.0, axis=2, dims=3)
    assert [type(v) for v in (made.count, made.length, made.axis)] == [
        int,
        float,
        int,
    ]  # dims come first
    assert made.total == 6.0  # `_check` runs after all fields
    assert made.spec == "waves(count=2, length=3.0, axis=2)"
    assert made.phase is None


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("count", 10),
        ("count", None),
        ("length", 0),
        ("length", None),
        ("phase", -1.0),
        ("kind", "round"),
        ("steps_", 0.5),
        ("closed", 1),
        ("dims", 0),
    ],
)
def test_a_field_refuses_by_its_name(name, value):
    with pytest.raises(ParameterError, match=rf"^{name.rstrip('_')} is "):
        Waves(**{"count": 1, name: value})
