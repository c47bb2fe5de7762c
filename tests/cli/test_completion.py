"""The shell completes commands, options and names, and imports nothing heavy for it."""

from __future__ import annotations

from tests.cli.runner import python
from tests.cli.test_app import HEAVY

COMPLETED = {
    "rlbench eva": "evaluate",
    "rlbench check our": "ours",
    "rlbench run -m mean,oidn/tu": "mean,oidn/tuned",
    "rlbench render --preset min": "mini",
    "rlbench run --scenes tem": "temple",
    "rlbench report paret": "pareto",
}
PROGRAM = f"""
import contextlib, io, os, sys
from rlbench.cli.app import app
for line, expected in {COMPLETED}.items():
    last = str(len(line.split()) - 1)
    os.environ |= {{"_RLBENCH_COMPLETE": "complete_bash", "COMP_WORDS": line, "COMP_CWORD": last}}
    with contextlib.redirect_stdout(io.StringIO()) as shown, contextlib.suppress(SystemExit):
        app(prog_name="rlbench")
    assert expected in shown.getvalue().split(), (line, shown.getvalue())
print(*[name for name in {HEAVY} if name in sys.modules])
"""


def test_names_are_completed_without_importing_torch():
    assert python("-c", PROGRAM) == "\n"
