"""Fixtures of the command line's tests."""

from tests.cli.conftest import (  # noqa: F401
    _own_logger,
    image_results,
    image_run,
    interrupts,
    plain_results,
    run_mean,
    small_disk,
)
