"""Section `allocation`: does every density become sample counts of exactly the budget, up to 4K?"""

from __future__ import annotations

from collections.abc import Iterator

import torch
from torch import Tensor

from rlbench.checks.stress.densities import DENSITIES
from rlbench.checks.stress.job import report_exception
from rlbench.checks.stress.result import Limits, StressResult, judge
from rlbench.checks.stress.section import SuiteSection
from rlbench.sampling import allocate_counts

__all__ = ["NAME", "SECTION"]

NAME = "allocation"
SIZES = ((1, 1), (1, 17), (7, 9), (77, 123), (1080, 1920), (2160, 3840))  # height and width
QUICK_SIZES = SIZES[:4]
BUDGETS = (0.0, 0.01, 0.5, 2.3, 8.0)  # samples per pixel
LARGE_BUDGETS = (0.5, 2.3)  # of images above MAX_SMALL pixels, to save time
MAX_SMALL = 77 * 123
POOL_SPP = 8  # most samples of a pixel
ROUNDING_SEED = 5
EXACT = Limits(good=0.0, fair=0.0, unit="samples")
REMEDY = "correct rlbench.sampling.allocate_counts"


def _run(is_quick: bool) -> Iterator[StressResult]:
    for height, width in QUICK_SIZES if is_quick else SIZES:
        for density in DENSITIES:
            test = f"{density}-{width}x{height}"
            try:
                yield _allocate(test, density, height, width)
            except Exception as error:  # the result of this test
                yield report_exception("", NAME, test, error)


def _allocate(test: str, density: str, height: int, width: int) -> StressResult:
    """Judge the samples too many, too few, or outside the limits, over all budgets."""
    values = DENSITIES[density](height, width)
    faults: dict[str, int] = {}
    for spp in BUDGETS if values.numel() <= MAX_SMALL else LARGE_BUDGETS:
        for floor in (0, 1) if spp >= 1 else (0,):
            wrong = _count_wrong(values, round(spp * values.numel()), floor)
            faults[f"{spp:g} spp from {floor}"] = wrong
    found = ", ".join(f"{count} at {case}" for case, count in faults.items() if count)
    return judge("", NAME, test, max(faults.values()), EXACT, found, REMEDY)


def _count_wrong(density: Tensor, total: int, floor: int) -> int:
    """Samples by which counts miss the total or the limits, or split equal pixels unevenly."""
    low = torch.full(density.shape, floor)
    counts = allocate_counts(density, total, low, POOL_SPP, (ROUNDING_SEED,))
    missed = abs(int(counts.sum()) - total)
    outside = int((low - counts).clamp_min(0).sum() + (counts - POOL_SPP).clamp_min(0).sum())
    is_constant = bool(density.max() == density.min())
    uneven = max(0, int(counts.max() - counts.min()) - 1) if is_constant else 0
    return missed + outside + uneven


SECTION = SuiteSection(NAME, "Does every density become counts of exactly the budget?", _run)
