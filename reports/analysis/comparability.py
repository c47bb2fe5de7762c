"""Which rows may share a table: one device, one preset, one version of each method, one cost."""

from __future__ import annotations

import pandas as pd

from rlbench.benchmark.results import HELD_OUT_PREFIX, TableError

__all__ = ["ReportError", "check_comparable", "cost_source", "select_device", "split_by_device"]

VERSION = ["dtype", "code_hash", "weights_hash"]  # one value of each per method in a report


class ReportError(TableError):
    """A results table whose rows cannot be compared in one report."""


def split_by_device(rows: pd.DataFrame) -> dict[str, pd.DataFrame]:
    """The rows of each device, by device name; a name is empty if no row has a device.

    The cost per sample belongs to the scene: its rows name the machine that rendered, and are
    in every part.
    """
    devices = sorted(set(rows.loc[rows["metric"] != "sample_ms", "device"]) - {""})
    if len(devices) < 2:
        return {(devices or [""])[0]: rows}
    return {name: rows[~rows["device"].isin(set(devices) - {name})] for name in devices}


def select_device(results: pd.DataFrame, device: str) -> tuple[pd.DataFrame, str]:
    """The rows of a device and its name; it need not be named if there is one.

    Raises ReportError, which lists the devices.
    """
    parts = split_by_device(results)
    if not device and len(parts) == 1:
        (name, rows), *_ = parts.items()
        return rows, name
    if device not in parts:
        requested = f"device '{device}'" if device else "no device"
        raise ReportError(
            f"{requested} was requested, and the results have times of {len(parts)}: "
            f"{'; '.join(name or 'unnamed' for name in parts)}. Name one with --device"
        )
    return parts[device], device


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


def _check_versions(measured: pd.DataFrame) -> None:
    # in a cross-validation each scene has weights of its own
    is_held_out = measured["weights_hash"].str.startswith(HELD_OUT_PREFIX)
    held_out_scene = measured["scene"].where(is_held_out, "")
    for column in VERSION:
        method = measured["method"]
        groups = [method, held_out_scene] if column == "weights_hash" else [method]
        for _, rows in measured.groupby(groups):
            versions = sorted(set(rows[column]))
            if len(versions) > 1:
                raise ReportError(
                    f"'{rows['method'].iloc[0]}' has results of {len(versions)} {column} values "
                    f"({', '.join(versions)}); report them separately, or remove the older results"
                )
