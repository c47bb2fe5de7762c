"""A hash of all that the clips of a preset depend on: the key under which a cache may keep them.

python -m rlbench.render.jobs.preset_hash mini
"""

from __future__ import annotations

import sys
from hashlib import sha256

from rlbench.render.jobs.render_clips import preset_jobs

__all__ = ["preset_hash"]


def preset_hash(preset: str) -> str:
    """16 hex digits of the names and content keys of a preset's clips, and of its sample pools.

    Nothing is rendered. Raises LookupError for an unknown preset.
    """
    jobs = preset_jobs(preset)
    content = [f"{job.name} {' '.join(job.preset.pools)} {job.content_key}" for job in jobs]
    return sha256("".join(content).encode()).hexdigest()[:16]


if __name__ == "__main__":
    sys.stdout.write(f"{preset_hash(sys.argv[1])}\n")
