"""Conformance checks: what every method must do, tested on closed-form clips.

They need no rendered clips, no renderer and no GPU. In the tests of a plugin, three lines run them
all, one test per check:

    import pytest
    from rlbench.checks.conformance import CHECKS, MethodUnderTest, run_check

    method = MethodUnderTest("mean")
    @pytest.mark.parametrize("name", CHECKS)
    def test_conformance(name): run_check(method, name).raise_if_failed()

`method` runs once for all checks that can share a run. A learned method gets random weights.

>>> from rlbench.checks.conformance import MethodUnderTest, run_check
>>> run_check(MethodUnderTest("mean"), "budget").verdict
<Verdict.PASSED: 'passed'>
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rlbench.checks.conformance.method_under_test import Check, MethodUnderTest
    from rlbench.checks.conformance.run import CHECKS, run_check, run_checks
    from rlbench.checks.result import CheckResult, Verdict
else:  # importing torch is postponed until a name is used
    import lazy_loader

    __getattr__, __dir__, _ = lazy_loader.attach(
        __name__,
        submod_attrs={
            "method_under_test": ["Check", "MethodUnderTest"],
            "run": ["CHECKS", "CheckResult", "Verdict", "run_check", "run_checks"],
        },
    )

__all__ = [
    "CHECKS",
    "Check",
    "CheckResult",
    "MethodUnderTest",
    "Verdict",
    "run_check",
    "run_checks",
]
