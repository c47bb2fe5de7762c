"""A submission from a results folder and the clips that its scores are of."""

from __future__ import annotations

import importlib.metadata
import math
from collections.abc import Collection, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rlbench.benchmark.clip_sources import StoredSource
from rlbench.benchmark.results import EVENT_PREFIX, WHOLE_CLIP, RowName, cells
from rlbench.benchmark.submission.document import (
    LICENCE,
    ClipFacts,
    ClipValue,
    MetricFacts,
    Submission,
    SubmissionError,
    SubmittedCell,
)
from rlbench.clips.clip_folders import find_all_clips
from rlbench.system import paths, provenance

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["CELL", "clip_facts", "collect_submission", "pool_of", "stored_clips"]

CELL = ["method", "clip", "target_spp", "seed", "device"]  # columns that name a cell
REPAIRED = "repaired"  # a count whose convention lists what was repaired
SCORE = ["metric", "unit", "direction", "convention"]


def collect_submission(
    table: pd.DataFrame,
    results: Path,
    clips: Mapping[str, StoredSource],
    *,
    licence: str = LICENCE,
    contact: str = "",
    note: str = "",
) -> Submission:
    """The rows of `table`, read from the folder `results`, as a submission without its hash.

    `clips` are those of `stored_clips`. Raises SubmissionError where a clip is not here, the rows
    are of several presets, or a cell is a trial run of a clip's first frames.
    """
    presets = sorted(set(table["preset"]))
    if len(presets) > 1:
        raise SubmissionError(
            f"the results are of presets {', '.join(name or 'none' for name in presets)}; a "
            "submission has one. Use a results folder for each"
        )
    if missing := sorted(set(table["clip"]) - clips.keys()):
        raise SubmissionError(
            f"the clips {', '.join(missing)} are not here, so their content cannot be stated. "
            "Name their folder with --clips, or run rlbench render"
        )
    hashes = {cell.key: cell.content_hash for cell in cells(results)}
    trials = [str(key) for key in hashes if key.first_frames_only and key.clip in clips]
    if trials:
        raise SubmissionError(
            f"{trials[0]} has the first frames alone (--limit-frames). Run the whole clip"
        )
    by_cell: dict[Any, str] = {
        (key.method, key.clip, key.target_spp, key.seed, key.device): content
        for key, content in hashes.items()
        if not key.metric
    }
    facts = {name: clip_facts(source, _pools(table, name)) for name, source in clips.items()}
    return Submission(
        version=importlib.metadata.version("rlbench"),
        commit=provenance.commit(),
        preset=presets[0],
        licence=licence,
        contact=contact,
        note=note,
        packages=provenance.versions(),
        machine=provenance.machine(),
        clips=tuple(facts[name] for name in sorted(set(table["clip"]))),
        metrics=_metrics(table),
        cells=tuple(
            _cell(rows, facts[str(rows["clip"].iloc[0])], by_cell.get(key, ""))
            for key, rows in table.groupby(CELL)
        ),
    )


def stored_clips(
    table: pd.DataFrame, folders: Iterable[Path] | None = None
) -> dict[str, StoredSource]:
    """The clips of a results table that are here, by name; nothing is rendered.

    They lie in `folders`, or in the cache if they are of a preset.
    """
    if folders is None:
        folders = [paths.clips_folder() / name for name in sorted(set(table["preset"])) if name]
        folders = [folder for folder in folders if folder.is_dir()]
    names = set(table["clip"])
    sources = [StoredSource(path) for path in find_all_clips(folders)]
    return {each.header.name: each for each in sources if each.header.name in names}


def clip_facts(source: StoredSource, pools: Collection[str]) -> ClipFacts:
    """What a submission says of a clip; its digests are computed now."""
    header = source.header
    return ClipFacts(
        name=header.name,
        scene=header.scene,
        height=header.height,
        width=header.width,
        frames=header.frames,
        digests={pool: source.content(pool) for pool in sorted(pools) if pool in header.pools},
        sampler=f"{header.sampler} {header.sampler_version}".strip(),
        device=header.device,
        noise_ceiling_db=header.noise_ceiling_db,
        licence=header.licence,
    )


def pool_of(method: str) -> str:
    """The pool that a row draws from; path for a method that is not installed."""
    from rlbench import registry

    try:
        return registry.get_variant(RowName.parse(method).method).traits.pool
    except registry.PluginError:
        return "path"


def _pools(table: pd.DataFrame, clip: str) -> set[str]:
    return {pool_of(name) for name in set(table.loc[table["clip"] == clip, "method"])} or {"path"}


def _metrics(table: pd.DataFrame) -> tuple[MetricFacts, ...]:
    """The scores of frames. Raises SubmissionError for a metric with two conventions."""
    is_event = table["metric"].str.startswith(EVENT_PREFIX) | (table["metric"] == REPAIRED)
    scores = (
        table.loc[(table["frame"] >= 0) & ~is_event, SCORE].drop_duplicates().sort_values(SCORE)
    )
    names = list(scores["metric"])
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise SubmissionError(
            f"the results have {', '.join(twice)} under two conventions, so they are of two "
            "versions or sizes. Run all methods again with one version, on clips of one size"
        )
    return tuple(MetricFacts(*row) for row in scores.itertuples(index=False, name=None))


def _cell(rows: pd.DataFrame, clip: ClipFacts, content: str) -> SubmittedCell:
    first = rows.iloc[0]
    names = (*CELL, "dtype", "code_hash", "weights_hash")
    fixed: dict[str, Any] = {name: _plain(first[name]) for name in names}
    frames = rows[(rows["frame"] >= 0) & ~rows["metric"].str.startswith(EVENT_PREFIX)]
    if frames.empty:
        reason = str(rows.loc[rows["metric"] == "psnr", "note"].iloc[0])
        return SubmittedCell(**fixed, content_hash=content, skipped=reason)
    notes = frames.loc[frames["note"] != ""].groupby("metric")["note"].first()
    spent = frames.drop_duplicates("frame").sort_values("frame")["mean_spp"]
    return SubmittedCell(
        **fixed,
        content_hash=content,
        config=next((text for text in rows["config"] if text not in ("", "{}")), "{}"),
        samples=tuple(round(float(mean) * clip.pixels) for mean in spent),
        scores={str(name): _by_frame(own, clip.frames) for name, own in frames.groupby("metric")},
        values=_values(rows[rows["frame"] == WHOLE_CLIP]),
        notes={str(name): str(text) for name, text in notes.items()},
    )


def _by_frame(rows: pd.DataFrame, frames: int) -> tuple[float | None, ...]:
    values = dict(zip(rows["frame"], rows["value"], strict=True))
    return tuple(_number(values.get(frame, math.nan)) for frame in range(frames))


def _values(rows: pd.DataFrame) -> dict[str, ClipValue]:
    columns = rows[["metric", "value", "unit", "convention", "note"]]
    return {
        str(metric): ClipValue(_number(value), unit, convention, note)
        for metric, value, unit, convention, note in columns.itertuples(index=False, name=None)
    }


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _plain(value: object) -> object:
    """A number of numpy as one of Python."""
    return value.item() if hasattr(value, "item") else value
