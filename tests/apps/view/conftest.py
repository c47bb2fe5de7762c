"""Results from formulas, as in the tests of reports."""

from tests.reports.conftest import results  # noqa: F401
