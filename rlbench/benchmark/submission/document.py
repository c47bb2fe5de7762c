"""The file of a submission: typed JSON, one cell a line, with a hash of its content.

The hash finds a change, by accident or by hand. It is no signature: whoever changes a number can
also compute a new hash. Who vouches for a file is said by where it was published.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from hashlib import sha256
from pathlib import Path
from typing import Any

from rlbench.errors import RlbenchError
from rlbench.system import documents, paths
from rlbench.system.provenance import Machine

__all__ = [
    "LICENCE",
    "SCHEMA",
    "SUFFIX",
    "ClipFacts",
    "ClipValue",
    "MetricFacts",
    "Submission",
    "SubmissionError",
    "SubmittedCell",
    "content_hash",
    "read_submission",
    "write_submission",
]

SCHEMA = 1
SUFFIX = ".rlbench.json"
LICENCE = "CC-BY-4.0"  # of the numbers, unless another is given
MAX_BYTES = 2**28  # of a file that is read
CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]")  # all but tab and line feed
MAX_SIDE, MAX_SPP = 2**16, 2**16  # of clips and budgets


class SubmissionError(RlbenchError, ValueError):
    """A file that is no submission, or results that cannot be one."""


@dataclass(frozen=True)
class ClipFacts:
    """What identifies a clip, and what scores on it can be."""

    name: str
    scene: str
    height: int  # pixels
    width: int
    frames: int
    digests: Mapping[str, str]  # 32 hex digits of the content with the samples of a pool, by pool
    sampler: str  # that traced the samples, and its version
    device: str  # that traced the samples
    noise_ceiling_db: tuple[float, ...] = ()  # of each frame's reference; empty where not known
    licence: str = ""  # of the images

    def __post_init__(self) -> None:
        """Raise ValueError for a size that no clip has, and for a ceiling that is no PSNR."""
        if not all(0 < number <= MAX_SIDE for number in (self.height, self.width, self.frames)):
            raise ValueError(f"clip {self.name}: height, width and frames are 1 to {MAX_SIDE}")
        if not all(0 <= ceiling <= 200 for ceiling in self.noise_ceiling_db):
            raise ValueError(f"clip {self.name}: a noise ceiling is 0 to 200 dB")

    @property
    def pixels(self) -> int:
        """Pixels of an image."""
        return self.height * self.width


@dataclass(frozen=True)
class MetricFacts:
    """What a score of this name is."""

    name: str
    unit: str
    direction: str  # "higher" or "lower" is better, or empty
    convention: str


@dataclass(frozen=True)
class ClipValue:
    """A number of a whole clip: a time, or what the clock saw."""

    value: float | None  # None with a note
    unit: str = ""
    convention: str = ""
    note: str = ""


@dataclass(frozen=True)
class SubmittedCell:
    """The numbers of one method on one clip at one budget with one seed on one device."""

    method: str
    clip: str
    target_spp: float  # requested samples per pixel
    seed: int
    device: str  # that ran the method
    dtype: str
    content_hash: str  # of all that the scores depend on, as in the results
    code_hash: str
    weights_hash: str = ""
    config: str = "{}"
    samples: tuple[int, ...] = ()  # drawn in each frame, of all pixels
    scores: Mapping[str, tuple[float | None, ...]] = field(default_factory=dict)  # of each frame
    values: Mapping[str, ClipValue] = field(default_factory=dict)  # of the whole clip
    notes: Mapping[str, str] = field(default_factory=dict)  # by metric
    skipped: str = ""  # why there are no numbers

    def __post_init__(self) -> None:
        """Raise ValueError for a budget that no run has."""
        if not 0 <= self.target_spp <= MAX_SPP:
            raise ValueError(f"{self}: a budget is 0 to {MAX_SPP} spp")

    def __str__(self) -> str:
        """The cell in words, for messages."""
        return f"{self.method} on {self.clip} at {self.target_spp:g} spp, seed {self.seed}"


@dataclass(frozen=True)
class Submission:
    """Results with all that is needed to check them."""

    version: str  # of rlbench
    preset: str  # of the clips; empty for clips of no preset
    licence: str  # of the numbers, an SPDX identifier
    packages: Mapping[str, str]  # versions by name
    machine: Machine  # that wrote the file
    clips: tuple[ClipFacts, ...]
    metrics: tuple[MetricFacts, ...]
    cells: tuple[SubmittedCell, ...]
    commit: str = ""  # of the rlbench checkout; + for changed files
    contact: str = ""  # an address or a page, if the author gives one
    note: str = ""  # by the author
    content_hash: str = ""  # SHA-256 of all other fields

    @property
    def clips_by_name(self) -> dict[str, ClipFacts]:
        """The clips by name."""
        return {clip.name: clip for clip in self.clips}

    @property
    def measured(self) -> list[SubmittedCell]:
        """The cells with numbers."""
        return [cell for cell in self.cells if not cell.skipped]


def content_hash(submission: Submission) -> str:
    """SHA-256 of the content without the hash itself, in hexadecimal.

    It is that of JSON with sorted keys, without spaces, in UTF-8, so the order of the keys and the
    layout of the file do not matter.
    """
    document = _document(replace(submission, content_hash=""))
    text = json.dumps(
        document, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False
    )
    return sha256(text.encode()).hexdigest()


def write_submission(submission: Submission, path: Path) -> Submission:
    """Write a submission with its hash, which the returned one has too; one cell a line.

    Equal content gives equal bytes. Raises WriteError where the folder takes no file.
    """
    complete = replace(submission, content_hash=content_hash(submission))
    head = _document(complete)
    lists = {name: head.pop(name) for name in ("clips", "metrics", "cells")}
    parts = [json.dumps(head, indent=2, ensure_ascii=False).removesuffix("\n}")]
    for name, entries in lists.items():
        lines = ",\n".join(f"    {json.dumps(entry, ensure_ascii=False)}" for entry in entries)
        parts.append(f'  "{name}": [\n{lines}\n  ]')
    with paths.atomic_write(path) as temporary:
        temporary.write_text(",\n".join(parts) + "\n}\n", encoding="utf-8")
    return complete


def read_submission(path: Path) -> Submission:
    """The submission in a file; its content is not checked.

    Raises SubmissionError for a file that is not JSON, has another schema, or a missing, unknown or
    wrong field.
    """
    try:
        if path.stat().st_size > MAX_BYTES:
            raise ValueError(f"{path} has more than {MAX_BYTES} bytes")
        document = documents.read_json(path)
        schema = document.get("schema") if isinstance(document, dict) else type(document).__name__
        if schema != SCHEMA:
            raise ValueError(f"{path} has schema {schema}, this version reads {SCHEMA}")
        fields = {key: value for key, value in document.items() if key != "schema"}
        _check_keys(fields)
        _check_printable(fields)
        return documents.decode(fields, Submission)
    except OSError as error:
        raise SubmissionError(f"{path} cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise SubmissionError(
            f"{error}. A submission is written by rlbench submit; ask its author for the file"
        ) from error


def _check_keys(fields: Mapping[str, Any]) -> None:
    """Raise ValueError for a key that no field has: a number that no check reads would be there."""
    kinds = {"clips": ClipFacts, "metrics": MetricFacts, "cells": SubmittedCell}
    parts: list[tuple[str, Mapping[str, Any], type]] = [("the file", fields, Submission)]
    for name, kind in kinds.items():
        entries = fields.get(name, ())
        parts += [(name, entry, kind) for entry in entries if isinstance(entry, dict)]
    for where, entry, kind in parts:
        if unknown := documents.unknown_keys(entry, kind):
            raise ValueError(f"{where}: unknown fields {', '.join(unknown)}")


def _check_printable(document: Any) -> None:
    """Raise ValueError for a control character: texts of strangers are printed on a terminal."""
    if isinstance(document, str) and CONTROL.search(document):
        raise ValueError(f"the text {document[:40]!r} has control characters")
    if isinstance(document, dict):
        document = [*document, *document.values()]
    if isinstance(document, list):
        for each in document:
            _check_printable(each)


def _document(submission: Submission) -> dict[str, Any]:
    """The content as JSON types; empty fields of cells are left out."""
    document = {"schema": SCHEMA, **asdict(submission)}
    document["cells"] = [
        {key: value for key, value in cell.items() if value or key in ("target_spp", "seed")}
        for cell in document["cells"]
    ]
    return document
