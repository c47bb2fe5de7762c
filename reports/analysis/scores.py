"""Means of the results: over seeds, the frames of a clip, the clips of a scene, and scenes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import pandas as pd

from reports.analysis.intervals import FRAME, Interval, mean_with_interval, pair
from reports.analysis.rows import (
    check_comparable,
    cost_source,
    device_mixes,
    methods_from_elsewhere,
    remarks,
    skip_reasons,
    split_by_device,
    uncertain_times,
)
from rlbench.benchmark.results import CLOCK_PREFIX, COUNT_PREFIX, EVENT_PREFIX, NOISE_CEILING

HEADLINE = ["psnr", "psnr_debiased"]  # metrics that come first
GROUP = ["method", "scene", "target_spp"]
FRAME_PARTS = ["gbuffer_ms", "plan_ms", "allocate_ms", "sampling_ms", "denoise_ms"]  # of frame_ms
INFERENCE = ["plan_ms", "allocate_ms", "denoise_ms"]
ENDS = ("low", "high")  # of the interval of a time
TIMES = [*FRAME_PARTS, "inference_p95_ms"]
INTERVALS = [
    f"{part.removesuffix('_ms')}_{end}_ms" for part in (*FRAME_PARTS, "inference") for end in ENDS
]
LATE_SHARE = 0.05  # of the frames, where the deadline is the p95 of the frame time
CELL = ["method", "clip", "target_spp", "seed", "device", "frame"]


def metrics_with_values(rows: pd.DataFrame) -> list[str]:
    """Names of the metrics of images that have a value, PSNR and debiased PSNR first."""
    of_no_image = (CLOCK_PREFIX, COUNT_PREFIX, EVENT_PREFIX, NOISE_CEILING)
    is_other = rows["metric"].str.startswith(of_no_image)
    scored = rows[rows["value"].notna() & ~is_other & (rows["unit"] != "ms")]
    found = set(scored["metric"])
    return [*(name for name in HEADLINE if name in found), *sorted(found - set(HEADLINE))]


def keep_first_frames(rows: pd.DataFrame) -> pd.DataFrame:
    """The rows of the first frame of each clip, in a table without times."""
    return rows[rows["frame"] == rows.groupby("clip")["frame"].transform("min")]


def keep_last_frames(rows: pd.DataFrame) -> pd.DataFrame:
    """The rows of the last quarter of the frames of each clip, at least one frame."""
    frames = rows[rows["frame"] >= 0].groupby("clip")["frame"]
    end, count = frames.max(), frames.nunique()
    first = end - (count // 4).clip(lower=1) + 1
    return rows[rows["frame"] >= rows["clip"].map(first)]


def mean_over_scenes(per_scene: pd.DataFrame) -> pd.DataFrame:
    """Mean over scenes of each method and budget that has every scene of the table.

    `per_scene` is `Scores.points` or `Scores.scene_means`. A time that one scene lacks is nan.
    """
    scenes = per_scene["scene"].nunique()
    groups = per_scene.groupby(["method", "target_spp"])
    numbers = per_scene.select_dtypes("number").columns.drop("target_spp")
    means = groups[list(numbers)].sum(min_count=scenes) / scenes  # nan where a scene has none
    is_complete = groups["scene"].nunique() == scenes
    return pd.DataFrame(means[is_complete].reset_index())


@dataclass(frozen=True, eq=False)
class Scores:
    """The scores of one metric and the times of all methods on one device.

    A report builds one and asks it for all means. Each is computed once, at its first use. `rows`
    are those of one device (`split_by_device`), of all metrics, with the columns of the results.
    """

    rows: pd.DataFrame
    metric: str = "psnr"
    device: str = ""  # model name, empty if the rows have none

    @property
    def device_name(self) -> str:
        """The device, for use in a sentence."""
        return self.device or "an unnamed device"

    @cached_property
    def place(self) -> str:
        """The device and the size of the frames, for a title: `AMD EPYC, 192x192`."""
        sizes = sorted(set(self.rows["size"]) - {""})
        return ", ".join([self.device_name[:1].upper() + self.device_name[1:], *sizes])

    @cached_property
    def all_rows(self) -> pd.DataFrame:
        """The rows of the metric, those without a value too."""
        return self.rows[self.rows["metric"] == self.metric]

    @cached_property
    def measured(self) -> pd.DataFrame:
        """The rows of the metric that have a value."""
        return self.all_rows[self.all_rows["value"].notna()]

    @cached_property
    def cost_source(self) -> str:
        """The source of the cost per sample, empty without one."""
        return cost_source(self.rows)

    def column_text(self, column: str) -> str:
        """The text in `column` of the metric's rows; different texts are joined by semicolons."""
        return "; ".join(sorted(set(self.all_rows[column].unique()) - {""}))

    @property
    def convention(self) -> str:
        """How the metric was computed: peak, colour space."""
        return self.column_text("convention")

    @property
    def direction(self) -> str:
        """`higher` or `lower`, whichever is better; empty where neither is."""
        return self.column_text("direction")

    @cached_property
    def per_frame(self) -> pd.DataFrame:
        """Score of each method, scene, clip, budget and frame, averaged over seeds.

        A method that lacks frames which another method has on that scene has no comparable mean:
        its rows of that scene and budget are left out here and named by `incomplete_groups`.
        """
        is_complete = self._frame_counts["frames"] == self._frame_counts["expected"]
        return self._all_frames.merge(self._frame_counts[is_complete][GROUP], on=GROUP)

    @cached_property
    def clip_means(self) -> pd.DataFrame:
        """Columns method, scene, target_spp, clip, value: mean over the frames of a clip."""
        clips = self.per_frame.groupby([*GROUP, "clip"])["value"].mean()
        return pd.DataFrame(clips.reset_index())

    @cached_property
    def scene_means(self) -> pd.DataFrame:
        """Columns method, scene, target_spp, value: mean over clips of the mean over frames."""
        return pd.DataFrame(self.clip_means.groupby(GROUP)["value"].mean().reset_index())

    @cached_property
    def points(self) -> pd.DataFrame:
        """Score, drawn samples and each part of the frame time, per method, scene and budget.

        Columns method, scene, target_spp, value, mean_spp, gbuffer_ms, plan_ms, allocate_ms,
        sampling_ms, denoise_ms, inference_p95_ms, sample_ms, inference_ms, frame_ms; inference =
        plan + allocate + denoise, and frame = gbuffer + inference + sampling. Each PART_ms but the
        p95 and sample_ms has the ends of its interval, PART_low_ms and PART_high_ms: the time
        itself where it has none. Times that were not measured are nan.
        """
        spp = self.measured.groupby(GROUP)["mean_spp"].mean().reset_index()
        points = self.scene_means.merge(spp, on=GROUP, how="left")
        timed = self.rows[self.rows["metric"].isin([*TIMES, *INTERVALS])]
        times = timed.pivot_table("value", GROUP, "metric")
        times = times.reindex(columns=[*TIMES, *INTERVALS]).reset_index()
        points = points.merge(times, on=GROUP, how="left")
        points = points.merge(self._sample_ms, on=["method", "scene"], how="left")
        # images made elsewhere have no sampling time of their own
        is_claimed = points["method"].isin(methods_from_elsewhere(self.rows))
        charged = points["mean_spp"] * points["sample_ms"]
        points["sampling_ms"] = points["sampling_ms"].mask(is_claimed, charged)
        points["inference_ms"] = points[INFERENCE].sum(axis=1, skipna=False)
        points["frame_ms"] = points[FRAME_PARTS].sum(axis=1, skipna=False)
        for part in (*FRAME_PARTS, "inference_ms"):
            for end in ENDS:
                name = f"{part.removesuffix('_ms')}_{end}_ms"
                points[name] = points[name].fillna(points[part])
        for end in ENDS:
            parts = [f"{part}_{end}_ms" for part in ("gbuffer", "inference", "sampling")]
            points[f"frame_{end}_ms"] = points[parts].sum(axis=1, skipna=False)
        return points

    @cached_property
    def uncertain_times(self) -> list[str]:
        """Which times have a wide interval and why, one sentence for each part and reason."""
        return uncertain_times(self.rows)

    @property
    def remark_on_times(self) -> str:
        """One line on uncertain times, for figures; empty where there are none."""
        lines = self.uncertain_times
        more = f", and {len(lines) - 1} more in the report summary" * (len(lines) > 1)
        return f"Uncertain: {lines[0]}{more}." if lines else ""

    @cached_property
    def device_mixes(self) -> dict[str, list[str]]:
        """The methods whose frame times add times of two devices, by a text that names both."""
        return device_mixes(self.rows)

    @cached_property
    def overall(self) -> pd.DataFrame:
        """Mean over scenes of `points`, of methods and budgets with a score on every scene."""
        return mean_over_scenes(self.points)

    def gap(self, first: str, second: str, spp: float) -> Interval:
        """Score of `first` minus that of `second` at a budget, paired by frame."""
        frames = self.per_frame[self.per_frame["target_spp"] == spp]
        one, other = (frames[frames["method"] == method] for method in (first, second))
        return mean_with_interval(pair(one, other))

    @cached_property
    def incomplete_groups(self) -> list[str]:
        """Methods without a mean because they lack frames or scenes, one sentence each."""
        counts = self._frame_counts
        short = counts[counts["frames"] < counts["expected"]]
        lines = [
            f"{row.method} on {row.scene} at {row.target_spp:g} spp: {self.metric} of {row.frames} "
            f"frames, others have {row.expected}"
            for row in short.itertuples()
        ]
        for (method, spp), group in counts.groupby(["method", "target_spp"]):
            if absent := sorted(set(counts["scene"]) - set(group["scene"])):
                lines.append(f"{method} at {spp:g} spp: no {self.metric} on {', '.join(absent)}")
        return lines

    @property
    def skip_reasons(self) -> list[str]:
        """Why the metric was not measured, one sentence for each method and reason."""
        return skip_reasons(self.all_rows)

    @property
    def remarks(self) -> list[str]:
        """Notes on the metric's measured rows."""
        return remarks(self.all_rows)

    @cached_property
    def _all_frames(self) -> pd.DataFrame:
        frames = self.measured.groupby([*GROUP, "clip", "frame"])["value"].mean()
        return pd.DataFrame(frames.reset_index())

    @cached_property
    def _frame_counts(self) -> pd.DataFrame:
        """Frames of each method, scene and budget, and those that any method has on the scene."""
        counts = self._all_frames.groupby(GROUP, as_index=False).agg(frames=("value", "size"))
        distinct = self._all_frames.drop_duplicates(list(FRAME))
        expected = distinct.groupby("scene", as_index=False).agg(expected=("value", "size"))
        return counts.merge(expected, on="scene")

    @cached_property
    def _sample_ms(self) -> pd.DataFrame:
        """Time per sample of each method and scene; methods of other pools have other times."""
        samples = self.rows[self.rows["metric"] == "sample_ms"]
        clips: pd.Series[float] = samples.groupby(["method", "scene", "clip"])["value"].mean()
        scenes = clips.groupby(["method", "scene"]).mean().rename("sample_ms").reset_index()
        # images made elsewhere are charged the path samples that other methods of the scene buy
        paths = scenes.groupby("scene", as_index=False)["sample_ms"].min()
        claimed = [paths.assign(method=each) for each in methods_from_elsewhere(self.rows)]
        return pd.DataFrame(pd.concat([scenes, *claimed], ignore_index=True))


def scores_by_device(results: pd.DataFrame, metric: str = "psnr") -> Iterator[Scores]:
    """The scores of each device. Raises ReportError where its rows cannot be compared."""
    for device, rows in split_by_device(results).items():
        check_comparable(rows)
        yield Scores(rows, metric, device)


def with_misses(rows: pd.DataFrame, share: float = LATE_SHARE) -> pd.DataFrame:
    """The rows, with the expected PSNR of each frame if `share` of the frames are late.

    A frame is late by chance, and the frame before it was in time, so that the expected PSNR is
    (1 - share) psnr + share psnr_late. The first frame of a clip, and frames without `psnr_late`,
    keep their PSNR.
    """
    late = rows[rows["metric"] == "psnr_late"].set_index(CELL)["value"]
    scores = rows["metric"] == "psnr"
    keys = pd.MultiIndex.from_frame(rows.loc[scores, CELL])
    repeated = late.reindex(keys).to_numpy()
    in_time = rows.loc[scores, "value"]
    expected = (1 - share) * in_time + share * pd.Series(repeated, in_time.index)
    return rows.assign(value=rows["value"].mask(scores, expected.fillna(in_time)))
