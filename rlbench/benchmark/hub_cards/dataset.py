"""The card of a preset's clips, from their headers."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from statistics import fmean

from rlbench.benchmark.clip_sources import StoredSource
from rlbench.benchmark.hub_cards.layout import (
    INSTALL,
    REPOSITORY,
    TAGS,
    TASK,
    front_matter,
    hub_licence,
    table,
)
from rlbench.benchmark.submission.collect import clip_facts

__all__ = ["dataset_card"]

SIZES = ((1_000, "n<1K"), (10_000, "1K<n<10K"), (100_000, "10K<n<100K"))  # frames
DATASET = """# rlbench {preset}

{clips} path-traced clips for adaptive sampling and denoising. Each frame has a G-buffer
({buffers}), {pool_spp} independent images of 1 sample per pixel in each pool
({pools}), and a reference as two
independent halves, all linear HDR in OpenEXR.

{table}
The noise ceiling is the PSNR of the noise-free image against the reference, mean over frames. The
digest covers every sample, buffer and reference.

## Use

```bash
{install}
rlbench download --preset {preset} --mirror ADDRESS  # the archives and clips.toml of this page
rlbench run -m mean --preset {preset}
```

`rlbench.open_clip(folder)` reads a clip in Python. [The format]({format}) is OpenEXR and one TOML
file, so any viewer opens it.

## How it was made

`rlbench render --preset {preset}`, with {sampler}, on {device}. The scenes are procedural, so
nothing was collected and nobody is shown. Another processor may round some samples differently.

## Limits

References are noisy. Methods that were tuned or trained on these clips must not be scored on them.
"""


def dataset_card(preset: str, folders: Sequence[Path]) -> str:
    """The card of the clips in `folders`, at least one, which are of one preset."""
    sources = [StoredSource(folder) for folder in folders]
    facts = [clip_facts(source, source.header.pools) for source in sources]
    headers = [source.header for source in sources]
    frames = sum(header.frames for header in headers)
    metadata = {
        "pretty_name": f"rlbench {preset}",
        **hub_licence({header.licence for header in headers}),
        "task_categories": [TASK],
        "size_categories": [_size(frames)],
        "tags": TAGS,
    }
    rows = [
        (
            header.name,
            header.scene,
            f"{header.width}x{header.height}",
            str(header.frames),
            f"{min(header.reference_spp)} to {max(header.reference_spp)}",
            f"{fmean(header.noise_ceiling_db):.1f}" if header.noise_ceiling_db else "-",
            "; ".join(f"{pool} {digest[:12]}" for pool, digest in clip.digests.items()),
        )
        for header, clip in zip(headers, facts, strict=True)
    ]
    columns = ("clip", "scene", "size", "frames", "reference spp", "noise ceiling dB", "digest")
    first = headers[0]
    body = DATASET.format(
        preset=preset,
        clips=len(rows),
        buffers=", ".join(first.buffers),
        pool_spp=first.pool_spp,
        pools=", ".join(first.pools),
        table=table(columns, rows),
        format=f"{REPOSITORY}/blob/main/docs/reference/clip-format.md",
        install=INSTALL,
        sampler=f"{first.sampler} {first.sampler_version}",
        device=first.device or "an unknown machine",
    )
    return front_matter(metadata) + body


def _size(frames: int) -> str:
    return next((text for limit, text in SIZES if frames < limit), "100K<n<1M")
