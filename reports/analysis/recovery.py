"""Frames to recover: how long the PSNR stays low after a cut or a light change.

An event begins a span of frames, which ends at the next event or with the clip. The level of a
method after the event is its own mean PSNR over the last quarter of the span, at least LEVEL_FRAMES
frames. The frames to recover are those before the first whose PSNR is at most TOLERANCE_DB below
the level; a method that is there in the event's own frame needs 0. The loss is the level less the
PSNR of the event's frame.

Each method is compared with itself on the same shot, so a method without memory recovers at once,
but for what the picture's content changes. Where the level is first reached in the frames that
define it, the method may not have finished: its number is a lower bound.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import pandas as pd

from reports.analysis.aggregate import Scores
from rlbench.benchmark.results import EVENT_PREFIX

__all__ = ["LEVEL_FRAMES", "MIN_SPAN", "TOLERANCE_DB", "Recovery", "find_events", "find_spans"]
__all__ += ["measure_recoveries", "measure_span"]

TOLERANCE_DB = 0.5  # below the level, at which a method has recovered
LEVEL_FRAMES = 2  # fewest frames whose mean is a level
MIN_SPAN = 4  # fewest frames of a span that is measured: half of it may be the level
CURVE = ["method", "target_spp", "scene", "clip"]


class Recovery(NamedTuple):
    """What one event did to one method."""

    frames: int  # to recover
    loss: float  # dB below the level in the event's frame; negative where it is above
    level: float  # dB
    is_bound: bool  # `frames` is a lower bound


def measure_span(psnr: list[float]) -> Recovery:
    """The recovery in a span of at least MIN_SPAN frames, whose first is the event's.

    >>> measure_span([20.0, 23.0, 24.8, 25.0, 25.0, 25.0, 25.0, 25.0])
    Recovery(frames=2, loss=5.0, level=25.0, is_bound=False)
    """
    tail = max(LEVEL_FRAMES, len(psnr) // 4)
    level = sum(psnr[-tail:]) / tail
    frames = next(i for i, value in enumerate(psnr) if value >= level - TOLERANCE_DB)
    return Recovery(frames, level - psnr[0], level, frames >= len(psnr) - tail)


def find_events(rows: pd.DataFrame) -> pd.DataFrame:
    """Columns scene, clip, frame, event: each event of each clip once, in order.

    `event` is `cut`, `light`, or both joined by `and`, if one frame begins with both.
    """
    is_event = rows["metric"].str.startswith(EVENT_PREFIX)
    named = rows[is_event].assign(event=rows["metric"].str.removeprefix(EVENT_PREFIX))
    events = named.groupby(["scene", "clip", "frame"])["event"]
    return pd.DataFrame(events.agg(lambda names: " and ".join(sorted(set(names)))).reset_index())


def find_spans(scores: Scores) -> pd.DataFrame:
    """The events with the column `length`, the frames to the next event or to the clip's end."""
    events = find_events(scores.rows)
    ends = scores.measured.groupby("clip")["frame"].max() + 1
    last = events["clip"].map(ends).fillna(0)
    following = events.groupby("clip")["frame"].shift(-1)
    return events.assign(length=(following.fillna(last) - events["frame"]).astype(int))


def measure_recoveries(scores: Scores) -> pd.DataFrame:
    """One row for each method, budget and event, with the columns of `Recovery`.

    Further columns: method, target_spp, scene, clip, event, frame (of the event).
    """
    return pd.DataFrame(
        _measure(scores),
        columns=[*CURVE, "event", "frame", *("frames", "loss", "level", "is_bound")],
    )


def _measure(scores: Scores) -> Iterator[tuple[object, ...]]:
    spans = find_spans(scores)
    spans = spans[spans["length"] >= MIN_SPAN]
    for key, curve in scores.per_frame.groupby(CURVE):
        psnr = curve.set_index("frame")["value"].sort_index()
        for span in spans[spans["clip"] == key[-1]].to_dict("records"):
            values = psnr.loc[span["frame"] : span["frame"] + span["length"] - 1].tolist()
            if len(values) == span["length"]:
                yield (*key, span["event"], span["frame"], *measure_span(values))
