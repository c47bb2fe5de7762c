"""A real run with kept images on two small procedural clips."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest

import rlbench
from rlbench.clips.header import read_header, write_header
from rlbench.system import provenance
from tests.procedural_folder import write_world

SIDE, FRAMES = 48, 4


def run_with_images(
    folder: Path, methods: Sequence[str], spp: Sequence[float], cut: int, **options: object
) -> None:
    """Write `clips`, two of them with a cut at frame `cut`, and `results` with images."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RLBENCH_CACHE", str(folder / "cache"))
        for seed, name in enumerate(("alpha", "beta")):
            clip = write_world(folder / "clips" / name, seed, SIDE, FRAMES)
            header = replace(read_header(clip), cuts=(cut,), device=provenance.machine().name)
            write_header(clip, header)
        rlbench.run(
            list(methods), spp=list(spp), clips=[folder / "clips"], keep_images=True,
            out=folder / "results", **options,
        )  # fmt: skip
