"""What the results table says, read out: scores, times and reasons, of one device at a time."""

from __future__ import annotations

import pandas as pd

from rlbench.benchmark.results import HELD_OUT_PREFIX, TableError

CELL = ["method", "scene", "target_spp"]
SHOT = ["scene", "clip", "frame"]  # by which methods are paired
TIMES = ["plan_ms", "plan_p95_ms", "denoise_ms", "denoise_p95_ms"]
VERSION = [
    "dtype",
    "code_hash",
    "weights_hash",
]  # of one method, these have one value in one report


class ReportError(TableError):
    """A table of which no honest report can be made."""


def by_device(table: pd.DataFrame) -> dict[str, pd.DataFrame]:
    """The rows of each device; rows that belong to none of them are in every part.

    The cost per sample belongs to the scene, so its rows do not name a device of the methods.
    """
    devices = sorted(set(table.loc[table["metric"] != "sample_ms", "device"]) - {""})
    if len(devices) < 2:
        return {(devices or [""])[0]: table}
    return {name: table[~table["device"].isin(set(devices) - {name})] for name in devices}


def check(table: pd.DataFrame) -> None:
    """Raise ReportError where figures would be averaged that must not share a column."""
    if table.empty:
        raise ReportError("the results table has no rows; rlbench run makes some")
    devices = list(by_device(table))
    if len(devices) > 1:
        raise ReportError(f"rows of {len(devices)} devices in one column: {', '.join(devices)}")
    known = table[table["value"].notna() & (table["metric"] != "sample_ms")]
    for (scene, clip), rows in known.groupby(["scene", "clip"]):
        presets = [preset or "none" for preset in sorted(set(rows["preset"]))]
        if len(presets) > 1:
            raise ReportError(
                f"clip {clip} of scene {scene} is of {len(presets)} presets ({', '.join(presets)}),"
                " which share no pixel; measure each into a folder of its own (rlbench run --out)"
            )
    # in a cross-validation each scene has weights of its own
    apart = known["scene"].where(known["weights_hash"].str.startswith(HELD_OUT_PREFIX), "")
    for column in VERSION:
        alike = [known["method"], apart] if column == "weights_hash" else [known["method"]]
        for _, rows in known.groupby(alike):
            found = sorted(set(rows[column]))
            if len(found) > 1:
                raise ReportError(
                    f"'{rows['method'].iloc[0]}' has results of {len(found)} {column} values "
                    f"({', '.join(found)}); report them apart, or remove the older cells"
                )
    profile(table)


def profile(table: pd.DataFrame) -> str:
    """Whose cost per sample the table counts: the convention of its rows, or empty without any."""
    rows = table[(table["metric"] == "sample_ms") & table["value"].notna()]
    found = sorted(set(rows["convention"]))
    if len(found) > 1:
        raise ReportError(
            f"the cost per sample is from {len(found)} sources: {'; '.join(found)}; measure with "
            "one --cost, or each into a folder of its own (rlbench run --cost C --out FOLDER)"
        )
    return str(found[0]) if found else ""


def metrics(table: pd.DataFrame) -> list[str]:
    """Metrics that are not times and have a value, PSNR first."""
    rows = table[table["value"].notna() & (table["unit"] != "ms")]
    return sorted(set(rows["metric"]), key=lambda name: (name != "psnr", name))


def column_text(table: pd.DataFrame, metric: str, column: str) -> str:
    """What the rows of `metric` say in `column`, one text if they agree, else all of them."""
    found = sorted(set(table.loc[table["metric"] == metric, column]) - {""})
    return "; ".join(found)


def per_frame_scores(table: pd.DataFrame, metric: str) -> pd.DataFrame:
    """Score of each method, scene, clip, budget and frame, averaged over seeds, where complete.

    A method that lacks frames which another has on that scene has no mean that compares; those
    cells are left out here and told by `gaps`.
    """
    every = _every_shot(table, metric)
    counts = _counts(every)
    whole = counts[counts["frames"] == counts["asked"]][CELL]
    return every.merge(whole, on=CELL)


def incomplete_groups(table: pd.DataFrame, metric: str) -> list[str]:
    """What has no mean since frames or scenes are missing that others have, one sentence each."""
    counts = _counts(_every_shot(table, metric))
    short = counts[counts["frames"] < counts["asked"]]
    lines = [
        f"{row.method} on {row.scene} at {row.target_spp:g} spp: {metric} of {row.frames} frames, "
        f"others have {row.asked}"
        for row in short.itertuples()
    ]
    for (method, spp), cells in counts.groupby(["method", "target_spp"]):
        if absent := sorted(set(counts["scene"]) - set(cells["scene"])):
            lines.append(f"{method} at {spp:g} spp: no {metric} on {', '.join(absent)}")
    return lines


def clip_means(table: pd.DataFrame, metric: str) -> pd.DataFrame:
    """Columns method, scene, spp, clip, value: mean over the frames of a clip."""
    clips = per_frame_scores(table, metric).groupby([*CELL, "clip"])["value"].mean()
    return pd.DataFrame(clips.reset_index())


def scene_means(table: pd.DataFrame, metric: str) -> pd.DataFrame:
    """Columns method, scene, spp, value: mean over the frames of a clip, then over clips."""
    return pd.DataFrame(clip_means(table, metric).groupby(CELL)["value"].mean().reset_index())


def points(table: pd.DataFrame, metric: str = "psnr") -> pd.DataFrame:
    """One row a method, scene and budget: score, realised budget, and each part of its frame time.

    Columns method, scene, spp, value, mean_spp, plan_ms, plan_p95_ms, denoise_ms,
    denoise_p95_ms, sample_ms, sampling_ms, frame_ms, where
    total = plan + denoise + mean_spp * sample. What was not measured is nan.
    """
    scored = table[(table["metric"] == metric) & table["value"].notna()]
    realised = scored.groupby(CELL)["mean_spp"].mean().reset_index()
    found = scene_means(table, metric).merge(realised, on=CELL, how="left")
    timed = table[table["metric"].isin(TIMES)]
    parts = timed.pivot_table("value", CELL, "metric").reindex(columns=TIMES).reset_index()
    sampled = table[table["metric"] == "sample_ms"]
    # of the method's own pool: a sample of another kind has another price
    clips: pd.Series[float] = sampled.groupby(["method", "scene", "clip"])["value"].mean()
    cost = clips.groupby(["method", "scene"]).mean().rename("sample_ms").reset_index()
    found = found.merge(parts, on=CELL, how="left").merge(cost, on=["method", "scene"], how="left")
    found["sampling_ms"] = found["mean_spp"] * found["sample_ms"]
    found["frame_ms"] = found["plan_ms"] + found["denoise_ms"] + found["sampling_ms"]
    return found


def overall(per_scene: pd.DataFrame) -> pd.DataFrame:
    """Mean over scenes of what `points` or `scene_means` gives, where every scene is there.

    A time that a scene lacks has no mean.
    """
    scenes = per_scene["scene"].nunique()
    groups = per_scene.groupby(["method", "target_spp"])
    numbers = per_scene.select_dtypes("number").columns.drop("target_spp")
    means = groups[list(numbers)].agg(_whole_mean).reset_index()
    whole = groups["scene"].nunique().to_numpy() == scenes
    return pd.DataFrame(means[whole].reset_index(drop=True))


def _whole_mean(part: pd.Series[float]) -> float:
    return float(part.mean(skipna=False))


def pareto_front(times: pd.Series, values: pd.Series, better: str) -> list[int]:
    """Positions that no other beats in both time and value, by rising time."""
    sign = -1 if better == "lower" else 1
    order = sorted(range(len(times)), key=lambda i: (times.iloc[i], -sign * values.iloc[i]))
    kept: list[int] = []
    for i in order:
        if not kept or sign * values.iloc[i] > sign * values.iloc[kept[-1]]:
            kept.append(i)
    return kept


def reasons(table: pd.DataFrame) -> list[str]:
    """What was not measured and why, one sentence for each method and reason."""
    holes = table[table["value"].isna()]
    lines = []
    for (method, note), rows in holes.groupby(["method", "note"], sort=True):
        where = ", ".join(sorted({name for name in rows["scene"] if name})) or "any scene"
        budgets = ", ".join(f"{spp:g}" for spp in sorted(set(rows["target_spp"].dropna())))
        what = ", ".join(sorted(set(rows["metric"])))
        lines.append(f"{method} on {where} at {budgets or 'any'} spp ({what}): {note}")
    return lines


def remarks(table: pd.DataFrame) -> list[str]:
    """Notes on what was measured."""
    noted = table[table["value"].notna() & (table["note"] != "")]
    return sorted({f"{m}, {k}: {n}" for m, k, n in noted[["method", "metric", "note"]].to_numpy()})


def _every_shot(table: pd.DataFrame, metric: str) -> pd.DataFrame:
    rows = table[(table["metric"] == metric) & table["value"].notna()]
    return pd.DataFrame(rows.groupby([*CELL, "clip", "frame"])["value"].mean().reset_index())


def _counts(every: pd.DataFrame) -> pd.DataFrame:
    counts = every.groupby(CELL, as_index=False).agg(frames=("value", "size"))
    asked = (
        every.drop_duplicates(SHOT).groupby("scene", as_index=False).agg(asked=("value", "size"))
    )
    return counts.merge(asked, on="scene")
