"""Has quality fallen? PSNR per method, scene and budget against a committed baseline."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rlbench.benchmark.results import WHOLE_CLIP
from rlbench.errors import RlbenchError
from rlbench.system import paths

if TYPE_CHECKING:
    import pandas as pd

SCHEMA = 1
TOLERANCE_DB = 0.05  # two machines differ by less in float32, a broken method by more
DECIMALS = 4  # of dB, in the file and in the comparison
FAILING = ("worse", "missing")

Key = tuple[str, str, float]  # method, scene, samples per pixel asked for


class BaselineError(RlbenchError, ValueError):
    """A baseline that cannot be read, or a table that cannot be compared with it."""


@dataclass(frozen=True)
class Entry:
    """What a method reached on a scene at a budget: the mean over clips, seeds and frames."""

    method: str
    scene: str
    spp: float
    psnr: float  # dB
    tolerance_db: float | None = None  # by which it may fall, where not the file's

    @property
    def key(self) -> Key:
        """What makes an entry unique."""
        return self.method, self.scene, self.spp


@dataclass(frozen=True)
class Baseline:
    """The committed figures, and how they were made."""

    preset: str = ""
    command: str = ""
    tolerance_db: float = TOLERANCE_DB
    entries: tuple[Entry, ...] = ()


@dataclass(frozen=True)
class BaselineDiff:
    """One line of the comparison. `found` is None where it is missing, `expected` where new."""

    key: Key
    verdict: str  # worse, missing, better, new, same, or skipped
    expected: float | None
    found: float | None
    tolerance_db: float


@dataclass(frozen=True)
class RegressionReport:
    """The comparison, line by line."""

    changes: tuple[BaselineDiff, ...]

    @property
    def passed(self) -> bool:
        """Was anything compared, did nothing fall, and is nothing missing?"""
        failed = any(change.verdict in FAILING for change in self.changes)
        return not failed and not self.empty

    @property
    def empty(self) -> bool:
        """Is there not one result that stands beside an entry?"""
        return all(None in (change.expected, change.found) for change in self.changes)

    def of(self, verdict: str) -> list[BaselineDiff]:
        """The lines of one verdict."""
        return [change for change in self.changes if change.verdict == verdict]

    def text(self) -> str:
        """The differences as a table, failures first, and a last line that sums up."""
        order = ("worse", "missing", "better", "new")
        lines = [_line(change) for verdict in order for change in self.of(verdict)]
        counts = {verdict: len(self.of(verdict)) for verdict in (*order, "same", "skipped")}
        total = [f"{count} {verdict}" for verdict, count in counts.items() if count]
        total = ["nothing was compared"] * self.empty + total
        result = f"{'passed' if self.passed else 'FAILED'}: {', '.join(total)}"
        return "\n".join([*_aligned([_HEAD, *lines])] * bool(lines) + [result])


def load(path: Path) -> Baseline:
    """The baseline in a JSON file. Raises BaselineError, saying what is wrong with it."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise BaselineError(f"no baseline at {path}; rlbench regress --update makes one") from None
    except json.JSONDecodeError as error:
        raise BaselineError(f"{path} is not JSON: {error}") from None
    if not isinstance(content, dict) or content.get("schema") != SCHEMA:
        found = content.get("schema") if isinstance(content, dict) else type(content).__name__
        raise BaselineError(f"{path} has schema {found}, expected {SCHEMA}")
    try:
        entries = tuple(Entry(**entry) for entry in content["entries"])
        return Baseline(content["preset"], content["command"], content["tolerance_db"], entries)
    except (KeyError, TypeError) as error:
        raise BaselineError(f"{path} lacks a field or has one too many: {error}") from None


def compare(table: pd.DataFrame, baseline: Baseline, subset: bool = False) -> RegressionReport:
    """Each entry of the baseline and of the results table, side by side.

    An entry is worse when it fell by more than its tolerance, and better when it rose by more. A
    result without an entry is new. An entry without a result is missing, or skipped where `table`
    is known to be a subset and has other results of that method. A result of which any frame has no
    value counts as missing either way. Raises BaselineError for results of another preset, and as
    `measured` does.
    """
    if len(table) and (preset := _preset(table)) != baseline.preset:
        raise BaselineError(
            f"the results are of preset {preset or 'none'}, the baseline of "
            f"{baseline.preset or 'none'}: run that, or give --baseline another file"
        )
    found, expected = measured(table), {entry.key: entry for entry in baseline.entries}
    if len(expected) < len(baseline.entries):
        raise BaselineError("the baseline has two entries of one method, scene and budget")
    partly = {method for method, _, _ in found} if subset else set()
    changes = [_change(entry, baseline, found, partly) for entry in baseline.entries]
    for key in sorted(found.keys() - expected.keys()):
        if found[key] is not None:
            changes.append(BaselineDiff(key, "new", None, found[key], baseline.tolerance_db))
    return RegressionReport(tuple(changes))


def update(table: pd.DataFrame, path: Path) -> Baseline:
    """Rewrite the baseline at `path` from the results; tolerances and command are kept.

    Entries without a result are dropped: run the whole preset first. Cells that were refused, as
    half a sample by a method that needs one, are left out. Raises BaselineError if a frame has no
    value, or if a cell has none that the old baseline has one of, and as `measured` does.
    """
    old = load(path) if path.exists() else Baseline()
    limits = {entry.key: entry.tolerance_db for entry in old.entries}
    found = measured(table[table["frame"] != WHOLE_CLIP])
    lost = {key for key, psnr in measured(table).items() if psnr is None} & limits.keys()
    holes = [_name(key) for key in sorted({k for k, psnr in found.items() if psnr is None} | lost)]
    if holes or not found:
        raise BaselineError(f"cannot be a baseline: no PSNR of {', '.join(holes) or 'anything'}")
    entries = tuple(
        Entry(*key, psnr=psnr, tolerance_db=limits.get(key))
        for key, psnr in sorted(found.items())
        if psnr is not None
    )
    new = replace(old, preset=_preset(table), entries=entries)
    _write(new, path)
    return new


def measured(table: pd.DataFrame) -> dict[Key, float | None]:
    """PSNR of each method, scene and budget in dB, or None where a frame of it has no value.

    Raises BaselineError where results of several devices would be averaged.
    """
    rows = table[table["metric"] == "psnr"]
    if len(devices := sorted(set(rows["device"]) - {""})) > 1:
        raise BaselineError(
            f"the results are of {len(devices)} devices ({', '.join(devices)}); measure with one "
            "into a folder of its own"
        )
    groups = rows.groupby(["method", "scene", "spp"])["value"]
    means = groups.agg(lambda values: values.mean(skipna=False)).reset_index()
    keys = zip(means["method"], means["scene"], means["spp"], strict=True)
    values = [round(psnr, DECIMALS) if psnr == psnr else None for psnr in means["value"]]
    return dict(zip(keys, values, strict=True))


def _preset(table: pd.DataFrame) -> str:
    """The preset of all clips. Raises BaselineError where they are of several."""
    found = sorted(set(table["preset"]))
    if len(found) > 1:
        told = ", ".join(preset or "none" for preset in found)
        raise BaselineError(f"the results are of {len(found)} presets ({told}); measure one alone")
    return found[0] if found else ""


def _change(
    entry: Entry, baseline: Baseline, found: dict[Key, float | None], partly: set[str]
) -> BaselineDiff:
    """`partly` are the methods of which cells may be absent."""
    limit = baseline.tolerance_db if entry.tolerance_db is None else entry.tolerance_db
    psnr = found.get(entry.key)
    if psnr is None:
        absent = entry.key not in found
        verdict = "skipped" if absent and entry.method in partly else "missing"
        return BaselineDiff(entry.key, verdict, entry.psnr, None, limit)
    rise = round(psnr - entry.psnr, DECIMALS)  # 29.95 - 30 is to be -0.05, which is within 0.05
    verdict = "worse" if rise < -limit else "better" if rise > limit else "same"
    return BaselineDiff(entry.key, verdict, entry.psnr, psnr, limit)


_HEAD = ("", "method", "scene", "spp", "baseline", "found", "change", "allowed")


def _line(change: BaselineDiff) -> tuple[str, ...]:
    method, scene, spp = change.key
    expected, found = (math.nan if v is None else v for v in (change.expected, change.found))
    figures = [f"{expected:.3f}", f"{found:.3f}", f"{found - expected:+.3f}"]
    allowed = "-" if change.expected is None else f"-{change.tolerance_db:.3f}"
    verdict = change.verdict.upper() if change.verdict in FAILING else change.verdict
    return verdict, method, scene, f"{spp:g}", *("-" if "nan" in f else f for f in figures), allowed


def _aligned(lines: list[tuple[str, ...]]) -> list[str]:
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    spec = [f"{'<' if column < 3 else '>'}{width}" for column, width in enumerate(widths)]
    return ["  ".join(map(format, line, spec)) for line in lines]


def _name(key: Key) -> str:
    method, scene, spp = key
    return f"{method} on {scene} at {spp:g} spp"


def _write(baseline: Baseline, path: Path) -> None:
    """One entry a line, so that a change of one is a change of one line."""
    head: dict[str, Any] = {"schema": SCHEMA, **asdict(baseline)}
    entries = head.pop("entries")
    kept = [{k: v for k, v in entry.items() if v is not None} for entry in entries]
    lines = ",\n".join(f"    {json.dumps(entry, allow_nan=False)}" for entry in kept)
    opening = json.dumps(head, indent=2).removesuffix("\n}")
    with paths.replacing(path) as temporary:
        temporary.write_text(f'{opening},\n  "entries": [\n{lines}\n  ]\n}}\n', encoding="utf-8")
