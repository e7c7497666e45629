"""Small results, as the tests of reports make them."""

from tests.report.conftest import _make

__all__ = ["_make"]
