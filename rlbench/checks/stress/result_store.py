"""Results of finished jobs on disk: one JSON file a job, so that a stopped run resumes."""

from __future__ import annotations

import json
import re
from dataclasses import asdict, dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

from rlbench.checks.result import Verdict
from rlbench.checks.stress.job import StressJob
from rlbench.checks.stress.result import StressResult
from rlbench.system import documents, paths

__all__ = ["ResultStore"]

SCHEMA = 1


@dataclass(frozen=True)
class _Document:
    schema: int
    content_hash: str
    results: tuple[StressResult, ...]


@dataclass(frozen=True)
class ResultStore:
    """The results of jobs in `folder`, each in a file of its own."""

    folder: Path

    def read(self, job: StressJob, content_hash: str) -> tuple[StressResult, ...] | None:
        """The stored results of a job; None without them, or if they are of other content.

        A file that cannot be read is as if it were absent, since the job can run again.
        """
        try:
            content: dict[str, Any] = json.loads(self._file(job).read_text(encoding="utf-8"))
            stored = documents.decode(content, _Document)
        except (OSError, ValueError):  # absent, cut off, or of another version
            return None
        is_same = (stored.schema, stored.content_hash) == (SCHEMA, content_hash)
        return stored.results if is_same else None

    def write(self, job: StressJob, content_hash: str, results: tuple[StressResult, ...]) -> None:
        """Store the results of a job, in place of older ones."""
        document = asdict(_Document(SCHEMA, content_hash, results))
        with paths.atomic_write(self._file(job)) as unfinished:
            unfinished.write_text(json.dumps(document, default=_to_json, indent=1), "utf-8")

    def _file(self, job: StressJob) -> Path:
        """Two jobs never share a file, whatever characters their names have."""
        key = sha256(repr(job).encode()).hexdigest()[:8]
        name = re.sub(r"[^\w.+-]", "-", f"{job.method or 'suite'}--{job.section}", flags=re.ASCII)
        return self.folder / "jobs" / f"{name}-{key}.json"


def _to_json(value: object) -> str:
    assert isinstance(value, Verdict)
    return str(value.value)
