"""The content hash of a job: all that its results depend on, so that others are reused."""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache
from hashlib import sha256

from rlbench import registry
from rlbench.checks.stress.job import StressJob
from rlbench.checks.stress.sections import list_sections
from rlbench.system import code_hash, provenance

__all__ = ["content_hash"]

FRAME = ("rlbench.checks.stress.job", "rlbench.checks.stress.methods")  # code of all sections
HASH_LENGTH = 16  # hex digits


def content_hash(job: StressJob) -> str:
    """Hash of a job's section, method, code, weights and versions of packages."""
    target = list_sections()[job.section]
    content = (
        *(job.section, job.method, job.is_quick, job.device, provenance.versions()),
        _section_code(target.partition(":")[0]),
        *(_method_content(job.method) if job.method else (_metrics_code(),)),
    )
    return sha256(repr(content).encode()).hexdigest()[:HASH_LENGTH]


@lru_cache(maxsize=64)
def _section_code(module: str) -> str:
    return code_hash.code_hash(code_hash.import_closure(module), core=(*code_hash.CORE, *FRAME))


def _method_content(name: str) -> tuple[str, ...]:
    """Hashes of a method's code and weights, and versions of the packages that it requires."""
    variant, weights = registry.get_variant(name), ""
    if variant.learned and (file := registry.shipped_weights(name)).is_file():
        weights = sha256(file.read_bytes()).hexdigest()
    return registry.method_code_hash(name), weights, provenance.package_versions(variant.requires)


@lru_cache(maxsize=1)
def _metrics_code() -> str:
    """Hash of the installed metrics, which sections of the suite may call."""
    entries = registry.list_entries("metrics").values()
    return _hash_of(entry.target.partition(":")[0] for entry in entries)


def _hash_of(modules: Iterable[str]) -> str:
    closures = [code_hash.import_closure(module) for module in modules]
    return code_hash.code_hash(set().union(*closures), core=())
