"""Section `budgets`: budgets from 0 to above the pool, densities of any kind, sizes of any kind."""

from __future__ import annotations

from collections.abc import Iterator

import torch

from rlbench.checks.result import Verdict
from rlbench.checks.stress.job import raised
from rlbench.checks.stress.result import StressResult
from rlbench.checks.stress.section import MethodSection, StressedMethod
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import Size
from rlbench.run import FrameResult

__all__ = ["SECTION"]

NAME = "budgets"
SIZES = {(1, 1): 3, (1, 17): 3, (7, 9): 3, (77, 123): 3}  # height and width: frames
FULL_HD = (1080, 1920)


def _run(stressed: StressedMethod, is_quick: bool) -> Iterator[StressResult]:
    for (height, width), frames in SIZES.items():
        test = f"size-{width}x{height}"
        clip = procedural_clip(size=Size(1, height, width), frames=frames, device=stressed.device)
        try:
            found = _fault(stressed.run(clip))
        except Exception as error:
            yield raised(stressed.name, NAME, test, error)
            continue
        verdict = Verdict.FAILED if found else Verdict.PASSED
        yield StressResult(stressed.name, NAME, test, verdict, found=found)


def _fault(results: list[FrameResult]) -> str:
    for result in results:
        if not torch.isfinite(result.image).all():
            return "not finite"
    return ""


SECTION = MethodSection(NAME, "Does every budget, density and image size work?", _run)
