"""Scores with missed deadlines: a late frame shows the image of the frame before."""

from __future__ import annotations

import pandas as pd

__all__ = ["LATE_SHARE", "has_late_scores", "with_misses"]

LATE_SHARE = 0.05  # of the frames, where the deadline is the p95 of the frame time
LATE = "psnr_late"
CELL = ["method", "clip", "target_spp", "seed", "device", "frame"]


def has_late_scores(rows: pd.DataFrame) -> bool:
    """Whether the results have the PSNR of late frames; those of older versions lack it."""
    return bool((rows["metric"] == LATE).any())


def with_misses(rows: pd.DataFrame, share: float = LATE_SHARE) -> pd.DataFrame:
    """The rows, with the expected PSNR of each frame if `share` of the frames are late.

    A frame is late by chance, and the frame before it was in time, so that the expected PSNR is
    (1 - share) psnr + share psnr_late. The first frame of a clip, and frames without `psnr_late`,
    keep their PSNR.
    """
    late = rows[rows["metric"] == LATE].set_index(CELL)["value"]
    scores = rows["metric"] == "psnr"
    keys = pd.MultiIndex.from_frame(rows.loc[scores, CELL])
    repeated = late.reindex(keys).to_numpy()
    in_time = rows.loc[scores, "value"]
    expected = (1 - share) * in_time + share * pd.Series(repeated, in_time.index)
    return rows.assign(value=rows["value"].mask(scores, expected.fillna(in_time)))
