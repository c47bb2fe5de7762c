"""Rows of results, and a baseline that they are compared with."""

from __future__ import annotations

from dataclasses import replace

from rlbench.benchmark.regression.baseline import Baseline, BaselineEntry
from rlbench.benchmark.results import Row


def rows(psnr, method="ours", scene="city", spp=2.0, seed=0):
    """Two frames whose mean is `psnr`, and a row of another metric that must not count."""
    row = Row("r", method, f"{scene}-0", scene, spp, spp, 0, "psnr", psnr - 1, preset="mini")
    row = replace(row, seed=seed)
    other = replace(row, frame=-1, metric="relmse", value=99.0)
    return [row, replace(row, frame=1, value=psnr + 1), other]


def baseline(psnr=30.0, **entry):
    """One entry that the mean of `rows(psnr)` equals."""
    return Baseline(
        "mini", "rlbench run", 0.05, (BaselineEntry("ours", "city", 2.0, psnr, **entry),)
    )
