"""Rows of the results: parts of their names, which may share a table, and what their notes say."""

from __future__ import annotations

import math
from collections.abc import Collection, Set

import pandas as pd

from rlbench.benchmark.results import (
    HELD_OUT_PREFIX,
    IMAGES_PREFIX,
    NO_GBUFFER,
    TWO_DEVICES,
    UNCERTAIN,
    RowName,
    TableError,
)

VERSION = ["dtype", "code_hash", "weights_hash"]  # one value of each per method in a report
REASONS = ("inference_ms", "sample_ms")  # the times whose notes give the reasons once
FEW_METRICS = 2  # that a remark names one by one
NAMED_SCENES = 8  # that a reason names one by one
SAMPLE_TIMES = ("sample_ms", "sample_low_ms", "sample_high_ms")
GIVEN_GBUFFER = "given: --gbuffer-ms"  # convention of G-buffer times that do not grow with samples
MIXED_SIZES = 2  # factor in pixels from which on two sizes share no mean; films differ in shape
REQUESTED = ", requested "  # in a reason, before the budget that a sentence names anyway


class ReportError(TableError):
    """A results table whose rows cannot be compared in one report."""


def nearest_budget(budgets: Collection[float], spp: float = 1.0) -> float:
    """The budget nearest to one of so many samples per pixel, in ratio.

    >>> nearest_budget({0.5, 4.0})
    0.5
    >>> nearest_budget({0.5, 1.0, 4.0}, 2.8)
    4.0
    """
    return min(sorted(budgets), key=lambda each: max(each / spp, spp / max(each, 1e-9)))


def family_of(name: str) -> str:
    """The family: `ours` for `ours/A2@seed3`."""
    return RowName.parse(name).family


def label_of(name: str) -> str:
    """The label of weights or precision, `seed3` for `ours/A2@seed3`; empty without one."""
    return RowName.parse(name).label


def without_label(name: str) -> str:
    """The family and variant: `ours/A2` for `ours/A2@seed3`."""
    return RowName.parse(name).method_name


def training_series_of(name: str) -> str:
    """The name that all trainings of one method share; empty for a name without a label.

    >>> training_series_of("ours/A2@seed12")
    'ours/A2@seed'
    """
    return name.rstrip("0123456789") if label_of(name) else ""


def only_label(methods: Set[str]) -> str:
    """The label to compare by: the only one, if its families have no rows without a label.

    >>> only_label({"ours@brief", "ours/small@brief", "mean"}), only_label({"ours", "ours@seed1"})
    ('brief', '')
    """
    labelled = {method for method in methods if label_of(method)}
    labels, families = set(map(label_of, labelled)), set(map(family_of, labelled))
    is_alone = len(labels) == 1 and families.isdisjoint(map(family_of, methods - labelled))
    return labels.pop() if is_alone else ""


def split_by_device(rows: pd.DataFrame) -> dict[str, pd.DataFrame]:
    """The rows of each device, by device name; a name is empty if no row has a device.

    The cost per sample belongs to the scene: its rows name the machine that rendered, and are
    in every part. So are images made elsewhere, whose scores need no device and whose times are
    claims.
    """
    is_everywhere = (rows["metric"].isin(SAMPLE_TIMES)) | _is_from_elsewhere(rows)
    devices = sorted(set(rows.loc[~is_everywhere, "device"]) - {""})
    if not devices:
        devices = sorted(set(rows.loc[_is_from_elsewhere(rows), "device"]) - {""})[:1]
    if len(devices) < 2:
        return {(devices or [""])[0]: rows}
    return {name: rows[(rows["device"] == name) | is_everywhere] for name in devices}


def select_device(results: pd.DataFrame, device: str) -> tuple[pd.DataFrame, str]:
    """The rows of a device and its name; it need not be named if there is one.

    Raises ReportError, which lists the devices.
    """
    parts = split_by_device(results)
    if not device and len(parts) == 1:
        device = next(iter(parts))
    if device not in parts:
        requested = f"device '{device}'" if device else "no device"
        raise ReportError(
            f"{requested} was requested, and the results have times of {len(parts)}: "
            f"{'; '.join(name or 'unnamed' for name in parts)}. Name one with --device"
        )
    return parts[device], device


def charge_gbuffer(rows: pd.DataFrame, gbuffer_ms: float | None) -> pd.DataFrame:
    """The rows with another time of a G-buffer, for methods that read one; None changes nothing."""
    if gbuffer_ms is None:
        return rows
    reads = (rows["metric"] == "gbuffer_ms") & (rows["convention"] != NO_GBUFFER)
    return rows.assign(
        value=rows["value"].mask(reads, gbuffer_ms),
        convention=rows["convention"].mask(reads, GIVEN_GBUFFER),
    )


def check_comparable(rows: pd.DataFrame) -> None:
    """Raise ReportError if a mean over these rows would mix what cannot be compared."""
    if rows.empty:
        raise ReportError("the results table has no rows; measure some with rlbench run")
    devices = list(split_by_device(rows))
    if len(devices) > 1:
        raise ReportError(
            f"the table mixes {len(devices)} devices: {', '.join(devices)}; report each by itself"
        )
    measured = rows[rows["value"].notna() & (rows["metric"] != "sample_ms")]
    _check_presets(measured)
    _check_sizes(measured)
    _check_versions(measured)
    cost_source(rows)


def cost_source(rows: pd.DataFrame) -> str:
    """The source of the cost per sample: the convention of its rows, empty without such rows.

    Raises ReportError if there are several.
    """
    costs = rows[(rows["metric"] == "sample_ms") & rows["value"].notna()]
    sources = sorted(set(costs["convention"]))
    if len(sources) > 1:
        raise ReportError(
            f"the cost per sample comes from {len(sources)} sources: {'; '.join(sources)}; measure "
            "with one --cost, or into one folder per cost (rlbench run --cost C --out FOLDER)"
        )
    return str(sources[0]) if sources else ""


def _check_presets(measured: pd.DataFrame) -> None:
    for (scene, clip), rows in measured.groupby(["scene", "clip"]):
        presets = [preset or "none" for preset in sorted(set(rows["preset"]))]
        if len(presets) > 1:
            raise ReportError(
                f"clip {clip} of scene {scene} has rows of {len(presets)} presets "
                f"({', '.join(presets)}), which are different images; measure each preset into a "
                "folder of its own (rlbench run --out FOLDER)"
            )


def _check_sizes(measured: pd.DataFrame) -> None:
    """Raise ReportError for sizes whose numbers of pixels differ by a factor of MIXED_SIZES."""
    sizes = sorted(set(measured["size"]) - {""}, key=_count_pixels)
    if sizes and _count_pixels(sizes[-1]) >= MIXED_SIZES * _count_pixels(sizes[0]):
        raise ReportError(
            f"the results mix images of {' and '.join((sizes[0], sizes[-1]))} pixels, whose scores "
            "have no common mean; measure each size into a folder of its own (rlbench run --size "
            "WIDTHxHEIGHT --out FOLDER)"
        )


def _count_pixels(size: str) -> int:
    return math.prod(map(int, size.split("x")))


def _check_versions(measured: pd.DataFrame) -> None:
    # in a cross-validation each scene has weights of its own
    is_held_out = measured["weights_hash"].str.startswith(HELD_OUT_PREFIX)
    held_out_scene = measured["scene"].where(is_held_out, "")
    has_code = ~_is_from_elsewhere(measured)
    for column in VERSION:
        compared = measured[has_code] if column == "code_hash" else measured
        method = compared["method"]
        groups = [method, held_out_scene] if column == "weights_hash" else [method]
        for _, rows in compared.groupby(groups):
            versions = sorted(set(rows[column]))
            if len(versions) > 1:
                raise ReportError(
                    f"'{rows['method'].iloc[0]}' has results of {len(versions)} {column} values "
                    f"({', '.join(versions)}); report them separately, or remove the older results"
                )


def skip_reasons(rows: pd.DataFrame) -> list[str]:
    """What was not measured and why, one sentence for all methods that share place and reason.

    Many scenes are counted, not named.
    """
    skipped = rows[rows["value"].isna()]
    reasons = skipped["note"].map(lambda note: note.partition(REQUESTED)[0]).rename("reason")
    methods: dict[str, list[str]] = {}
    for (method, reason), group in skipped.groupby(["method", reasons], sort=True):
        scenes = sorted({name for name in group["scene"] if name})
        named = ", ".join(scenes) if len(scenes) <= NAMED_SCENES else f"{len(scenes)} scenes"
        metrics = ", ".join(sorted(set(group["metric"])))
        place = f"on {named or 'any scene'} at {_budgets(group) or 'any'} spp ({metrics}): {reason}"
        methods.setdefault(place, []).append(str(method))
    return [f"{', '.join(names)} {place}" for place, names in methods.items()]


def methods_from_elsewhere(rows: pd.DataFrame) -> list[str]:
    """The methods whose images were made elsewhere, so that nothing of them was verified."""
    return sorted(set(rows.loc[_is_from_elsewhere(rows), "method"]))


def _is_from_elsewhere(rows: pd.DataFrame) -> pd.Series[bool]:
    return rows["code_hash"].str.startswith(IMAGES_PREFIX)


def remarks(rows: pd.DataFrame) -> list[str]:
    """Notes on rows with a value, but those on times, each once for a method and metric.

    A note on many metrics names their number.
    """
    is_about_times = rows["note"].str.startswith((UNCERTAIN, TWO_DEVICES))
    noted = rows[rows["value"].notna() & (rows["note"] != "") & ~is_about_times]
    lines = []
    for (method, note), group in noted.groupby(["method", "note"]):
        metrics = sorted(set(group["metric"]))
        few = len(metrics) <= FEW_METRICS
        lines += [f"{method}, {each}: {note}" for each in metrics] if few else []
        lines += [] if few else [f"{method}, {len(metrics)} metrics: {note}"]
    return sorted(lines)


def uncertain_times(rows: pd.DataFrame) -> list[str]:
    """Which times have a wide interval and why, one sentence for each part of a frame and reason.

    Parts are inference and samples; a frame's time has their reasons.
    """
    marked = rows[rows["metric"].isin(REASONS) & rows["note"].str.startswith(UNCERTAIN)]
    reasons = marked["note"].map(lambda note: note.removeprefix(UNCERTAIN).partition(" (")[0])
    lines = []
    for (metric, reason), group in marked.groupby(["metric", reasons.str.strip()]):
        methods, scenes = (", ".join(sorted(set(group[name]))) for name in ("method", "scene"))
        lines.append(f"{metric} of {methods} on {scenes} at {_budgets(group)} spp: {reason}")
    return sorted(lines)


def device_mixes(rows: pd.DataFrame) -> dict[str, list[str]]:
    """The methods whose frame times add times of two devices, by a text that names both."""
    frames = rows[(rows["metric"] == "frame_ms") & rows["note"].str.contains(TWO_DEVICES)]
    texts = frames["note"].map(lambda note: note.partition(TWO_DEVICES)[2].strip())
    return {str(text): sorted(set(part)) for text, part in frames["method"].groupby(texts)}


def _budgets(rows: pd.DataFrame) -> str:
    return ", ".join(f"{spp:g}" for spp in sorted(set(rows["target_spp"].dropna())))
