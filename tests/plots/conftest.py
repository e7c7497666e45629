"""Small results from the tests of reports."""

from tests.report.conftest import _make

__all__ = ["_make"]
