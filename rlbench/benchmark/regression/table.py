"""A baseline as a results table: what reports read, with one PSNR for each scene."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rlbench.benchmark.regression.baseline import Baseline
from rlbench.benchmark.row import COLUMNS, DEFAULTS

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["to_table"]

CONVENTION = "peak 1, clipped sRGB, 1.0 = display white, at most 100 dB"  # of metric psnr


def to_table(baseline: Baseline) -> pd.DataFrame:
    """The entries as rows of `results.read`: the mean over a scene's frames, as one frame.

    >>> from rlbench.benchmark.regression.baseline import find_baseline, load_baseline
    >>> table = to_table(load_baseline(find_baseline("mini")))
    >>> sorted(set(table["scene"])), set(table["metric"])
    (['city', 'hall', 'ripples', 'temple'], {'psnr'})
    """
    import pandas as pd

    fixed = {
        **DEFAULTS,
        "run_id": f"baseline {baseline.preset}",
        "frame": 0,
        "metric": "psnr",
        "unit": "dB",
        "direction": "higher",
        "convention": CONVENTION,
        "preset": baseline.preset,
        "seed": baseline.seed,
    }
    rows = [
        {
            **fixed,
            "method": entry.method,
            "clip": entry.scene,
            "scene": entry.scene,
            "target_spp": entry.target_spp,
            "mean_spp": entry.target_spp,
            "value": entry.psnr,
        }
        for entry in baseline.entries
    ]
    return pd.DataFrame(rows, columns=list(COLUMNS))
