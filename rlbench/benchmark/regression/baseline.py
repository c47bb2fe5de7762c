"""The baseline of the regression check: PSNR per method, scene and budget, in JSON.

Baselines of some presets ship with the package; anyone writes their own by `rlbench regress
--update --baseline FILE`.
"""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass
from dataclasses import fields as dataclass_fields
from pathlib import Path
from typing import Any, NamedTuple

from rlbench.errors import RlbenchError
from rlbench.system import documents, paths

__all__ = [
    "Baseline",
    "BaselineEntry",
    "BaselineError",
    "ScoreKey",
    "find_baseline",
    "load_baseline",
    "shipped_baselines",
    "write_baseline",
]

SHIPPED = Path(__file__).parent / "baselines"
SCHEMA = 3
TOLERANCE_DB = 0.05  # two machines differ by less in float32, a broken method by more


class BaselineError(RlbenchError, ValueError):
    """A baseline that cannot be read, or results that cannot be compared with it."""


class ScoreKey(NamedTuple):
    """What a baseline has one PSNR of."""

    method: str  # name of the rows
    scene: str
    target_spp: float  # requested samples per pixel

    def __str__(self) -> str:
        """The key in words, for messages."""
        return f"{self.method} on {self.scene} at {self.target_spp:g} spp"


@dataclass(frozen=True)
class BaselineEntry:
    """PSNR of a method on a scene at a budget: the mean over clips and frames."""

    method: str
    scene: str
    target_spp: float  # requested samples per pixel
    psnr: float  # dB
    tolerance_db: float | None = None  # largest allowed fall; None: the baseline's
    stderr_db: float | None = None  # standard error of the mean over `frames`
    frames: int | None = None  # frames of all clips

    def __post_init__(self) -> None:
        """Raise BaselineError for numbers that no score can be compared with."""
        if not math.isfinite(self.psnr):
            raise BaselineError(f"{self.key} has psnr {self.psnr}; a finite number is required")
        if not (math.isfinite(self.target_spp) and self.target_spp >= 0):
            raise BaselineError(
                f"target_spp is {self.target_spp}; a finite number >= 0 is required"
            )
        if self.tolerance_db is not None:
            _check_tolerance(self.tolerance_db)
        if self.stderr_db is not None and not 0 <= self.stderr_db < math.inf:
            raise BaselineError(f"stderr_db is {self.stderr_db}; a finite number >= 0 is required")

    @property
    def key(self) -> ScoreKey:
        """Identity of the entry."""
        return ScoreKey(self.method, self.scene, self.target_spp)


@dataclass(frozen=True)
class Baseline:
    """The expected scores and speeds, and how they were made."""

    preset: str = ""
    command: str = ""
    tolerance_db: float = TOLERANCE_DB  # what machines differ by
    entries: tuple[BaselineEntry, ...] = ()
    seed: int = 0  # of the sample order that the scores are of
    speed: tuple[str, ...] = ()  # gates such as "ours / oidn <= 1.3"

    def __post_init__(self) -> None:
        """Raise BaselineError for a tolerance that no score can exceed."""
        _check_tolerance(self.tolerance_db)


def shipped_baselines() -> list[str]:
    """Names of the baselines in the package: the presets that they are of.

    >>> shipped_baselines()
    ['mini']
    """
    return sorted(file.stem for file in SHIPPED.glob("*.json"))


def find_baseline(name: str, preset: str = "") -> Path:
    """The file of a shipped baseline, or `name` as a path; an empty name is that of the preset.

    Raises BaselineError if `name` is empty and no baseline of the preset ships.
    """
    if (name or preset) in shipped_baselines():
        return SHIPPED / f"{name or preset}.json"
    if not name:
        raise BaselineError(
            f"no baseline of {f'preset {preset}' if preset else 'these clips'} ships; available: "
            f"{', '.join(shipped_baselines())}. Write your own: rlbench regress --update "
            "--baseline FILE"
        )
    return Path(name)


def load_baseline(path: Path) -> Baseline:
    """The baseline in a JSON file. Raises BaselineError, saying what is wrong with it."""
    try:
        content = documents.read_json(path)
    except FileNotFoundError:
        raise BaselineError(
            f"no baseline at {path}; rlbench regress --update --baseline {path} makes one"
        ) from None
    except (OSError, ValueError) as error:
        raise BaselineError(f"{error}. Restore the file, or pass another --baseline") from None
    schema = content.get("schema") if isinstance(content, dict) else type(content).__name__
    if schema != SCHEMA:
        raise BaselineError(
            f"{path} has schema {schema}, expected {SCHEMA}. Restore the file, or pass another "
            "--baseline"
        )
    try:
        return _decode(content)
    except ValueError as error:
        raise BaselineError(
            f"{path} has a missing, unknown or wrong field: {error}. Correct it, or rewrite the "
            "baseline with rlbench regress --update"
        ) from None


def write_baseline(baseline: Baseline, path: Path) -> None:
    """Write a baseline with one entry a line, so that each changed entry is one changed line."""
    head: dict[str, Any] = {"schema": SCHEMA, **asdict(baseline)}
    entries = [
        {key: value for key, value in entry.items() if value is not None}
        for entry in head.pop("entries")
    ]
    lines = ",\n".join(f"    {json.dumps(entry, allow_nan=False)}" for entry in entries)
    opening = json.dumps(head, indent=2).removesuffix("\n}")
    with paths.atomic_write(path) as temporary:
        temporary.write_text(f'{opening},\n  "entries": [\n{lines}\n  ]\n}}\n', encoding="utf-8")


def _decode(document: dict[str, Any]) -> Baseline:
    """The baseline in a JSON document. Raises ValueError, naming the field that is wrong."""
    fields = {key: value for key, value in document.items() if key != "schema"}
    if missing := sorted({f.name for f in dataclass_fields(Baseline)} - fields.keys()):
        raise ValueError(f"missing keys {', '.join(missing)}")
    _check_keys(fields, Baseline)
    for entry in fields["entries"] if isinstance(fields["entries"], list) else ():
        if isinstance(entry, dict):  # anything else is left for `documents.decode` to refuse
            _check_keys(entry, BaselineEntry)
    return documents.decode(fields, Baseline)


def _check_keys(document: dict[str, Any], kind: type) -> None:
    if unknown := documents.unknown_keys(document, kind):
        raise ValueError(f"unknown keys {', '.join(unknown)}")


def _check_tolerance(tolerance_db: float) -> None:
    """Every comparison with NaN is false, so no score would ever be worse."""
    if not (math.isfinite(tolerance_db) and tolerance_db >= 0):
        raise BaselineError(f"tolerance_db is {tolerance_db}; a finite number >= 0 is required")
