"""The committed baseline of the regression check: PSNR per method, scene and budget, in JSON."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

from rlbench.benchmark import results_v1
from rlbench.errors import RlbenchError
from rlbench.system import documents, paths

__all__ = ["Baseline", "BaselineEntry", "BaselineError", "ScoreKey", "load_baseline"]

SCHEMA = 2
SCHEMAS = (1, SCHEMA)  # that are read; schema 1 has `spp` and rows METHOD@half
RENAMED = {"spp": "target_spp"}  # keys of schema 1
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
    """PSNR of a method on a scene at a budget: the mean over clips, seeds and frames."""

    method: str
    scene: str
    target_spp: float  # requested samples per pixel
    psnr: float  # dB
    tolerance_db: float | None = None  # largest allowed fall; None: the baseline's

    @property
    def key(self) -> ScoreKey:
        """Identity of the entry."""
        return ScoreKey(self.method, self.scene, self.target_spp)


@dataclass(frozen=True)
class Baseline:
    """The committed scores, and how they were made."""

    preset: str = ""
    command: str = ""
    tolerance_db: float = TOLERANCE_DB
    entries: tuple[BaselineEntry, ...] = ()


def load_baseline(path: Path) -> Baseline:
    """The baseline in a JSON file. Raises BaselineError, saying what is wrong with it."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise BaselineError(f"no baseline at {path}; rlbench regress --update makes one") from None
    except json.JSONDecodeError as error:
        raise BaselineError(f"{path} is not JSON: {error}") from None
    if not isinstance(content, dict) or content.get("schema") not in SCHEMAS:
        schema = content.get("schema") if isinstance(content, dict) else type(content).__name__
        raise BaselineError(
            f"{path} has schema {schema}, expected {' or '.join(map(str, SCHEMAS))}"
        )
    try:
        entries = tuple(_entry(entry) for entry in content["entries"])
        return Baseline(content["preset"], content["command"], content["tolerance_db"], entries)
    except (KeyError, TypeError, ValueError) as error:
        raise BaselineError(f"{path} has a missing, unknown or wrong field: {error}") from None


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


def _entry(document: dict[str, Any]) -> BaselineEntry:
    """An entry of either schema, under today's names."""
    today = {RENAMED.get(key, key): value for key, value in document.items()}
    if unknown := documents.unknown_keys(today, BaselineEntry):
        raise ValueError(f"unknown keys {', '.join(unknown)}")
    entry = documents.decode(today, BaselineEntry)
    return replace(entry, method=results_v1.current_name(entry.method))
