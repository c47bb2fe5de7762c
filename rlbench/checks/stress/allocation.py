"""Section `allocation`: every density becomes sample counts of exactly the budget, up to 4K."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

import torch
from jaxtyping import Float
from torch import Tensor

from rlbench.checks.result import CheckResult, Limits, judge
from rlbench.checks.stress.section import SuiteSection, attempt
from rlbench.sampling import allocate_counts

SIZES = ((1, 1), (1, 17), (7, 9), (77, 123), (1080, 1920), (2160, 3840))  # height and width
QUICK_SIZES = SIZES[:4]
BUDGETS = (0.0, 0.01, 0.5, 2.3, 8.0)  # samples per pixel
LARGE_BUDGETS = (0.5, 2.3)  # of images above MAX_SMALL pixels, to save time
MAX_SMALL = 77 * 123
POOL_SPP = 8  # most samples of a pixel
ROUNDING_SEED = 5
EXACT = Limits(good=0.0, fair=0.0, unit="samples")
REMEDY = "correct rlbench.sampling.allocate_counts"
DENORMAL = 1e-42  # 714 times the smallest float32 above 0
HUGE = 1e38  # its sum over an image is infinite in float32
SEED = 38


def _generator() -> torch.Generator:
    return torch.Generator().manual_seed(SEED)


def _one_hot(h: int, w: int) -> Tensor:
    density = torch.zeros(1, 1, h, w)
    density[..., h // 2, w // 2] = 1.0
    return density


def _half(h: int, w: int) -> Tensor:
    density = torch.zeros(1, 1, h, w)
    density[..., : (w + 1) // 2] = 1.0
    return density


def _denormal(h: int, w: int) -> Tensor:
    return (torch.rand(1, 1, h, w, generator=_generator()).double() * DENORMAL).float()


def _denormal_and_huge(h: int, w: int) -> Tensor:
    """The ratio of two neighbours exceeds the range of float32."""
    rows, columns = torch.meshgrid(torch.arange(h), torch.arange(w), indexing="ij")
    return torch.where((rows + columns) % 2 == 0, DENORMAL, HUGE)[None, None]


# Densities that no sensible method plans, by height and width
DENSITIES: dict[str, Callable[[int, int], Float[Tensor, "1 1 h w"]]] = {
    "zero": lambda h, w: torch.zeros(1, 1, h, w),
    "constant": lambda h, w: torch.full((1, 1, h, w), 0.7),
    "one-hot": _one_hot,
    "half": _half,
    # heavy-tailed: log-normal over about six decades
    "random": lambda h, w: torch.randn(1, 1, h, w, generator=_generator()).mul(3).exp(),
    "denormal": _denormal,
    "1e38": lambda h, w: torch.rand(1, 1, h, w, generator=_generator()) * HUGE,
    "denormal-1e38": _denormal_and_huge,
}


def _run(is_quick: bool) -> Iterator[CheckResult]:
    for height, width in QUICK_SIZES if is_quick else SIZES:
        for density in DENSITIES:
            test = f"{density}-{width}x{height}"
            yield attempt("", test, partial(_allocate, test, density, height, width))


def _allocate(test: str, density: str, height: int, width: int) -> CheckResult:
    """Judge the samples too many, too few, or outside the limits, over all budgets."""
    values = DENSITIES[density](height, width)
    faults: dict[str, int] = {}
    for spp in BUDGETS if values.numel() <= MAX_SMALL else LARGE_BUDGETS:
        for floor in (0, 1) if spp >= 1 else (0,):
            wrong = _count_wrong(values, round(spp * values.numel()), floor)
            faults[f"{spp:g} spp from {floor}"] = wrong
    found = ", ".join(f"{count} at {case}" for case, count in faults.items() if count)
    return judge(test, max(faults.values()), EXACT, found, REMEDY)


def _count_wrong(density: Tensor, total: int, floor: int) -> int:
    """Samples by which counts miss the total or the limits, or split equal pixels unevenly."""
    low = torch.full(density.shape, floor)
    counts = allocate_counts(density, total, low, POOL_SPP, (ROUNDING_SEED,))
    missed = abs(int(counts.sum()) - total)
    outside = int((low - counts).clamp_min(0).sum() + (counts - POOL_SPP).clamp_min(0).sum())
    is_constant = bool(density.max() == density.min())
    uneven = max(0, int(counts.max() - counts.min()) - 1) if is_constant else 0
    return missed + outside + uneven


SECTION = SuiteSection(_run)
