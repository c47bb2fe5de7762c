"""Which widths do best on training clips: python -m baselines.eaw.search CLIP-FOLDER..."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from baselines.eaw.method import Config, Eaw
from rlbench import registry
from rlbench.clips.in_memory import InMemoryClip
from rlbench.clips.stored import StoredClip, open_clip
from rlbench.run import run_clip

BUDGETS = (1.0, 4.0)  # samples per pixel
GRID = [
    Config(light=light, normal=normal, depth=depth)
    for light in (1.0, 4.0, 16.0, 64.0)
    for normal in (0.01, 0.1, 0.5)
    for depth in (1e-4, 1e-3, 1e-2)
]


def search(clips: Sequence[StoredClip], grid: Sequence[Config] = GRID) -> dict[Config, float]:
    """Mean PSNR in dB of each configuration over the first frames of `clips`, best first."""
    firsts = [InMemoryClip(clip.name, clip.scene, "", [clip.frame(0)]) for clip in clips]
    scores = {config: _score(Eaw(config), firsts) for config in grid}
    return dict(sorted(scores.items(), key=lambda item: -item[1]))


def _score(method: Eaw, clips: Sequence[InMemoryClip]) -> float:
    psnr = registry.load_plugin("metrics", "psnr").score
    scores = []
    for spp in BUDGETS:
        for clip in clips:
            for shown in run_clip(method, clip, spp):
                reference = shown.frame.reference
                scores.append(float(psnr(shown.image, reference.half_a, reference.half_b)))
    return sum(scores) / len(scores)


def main() -> None:
    """Write one line for each configuration, best first."""
    parser = argparse.ArgumentParser(
        prog="python -m baselines.eaw.search",
        description="PSNR of eaw by the widths of its weights, on the first frames of clips.",
        epilog="example: python -m baselines.eaw.search ~/.cache/rlbench/clips/train/*",
    )
    parser.add_argument("clips", type=Path, nargs="+", help="clip folders, of training scenes")
    needs = Eaw().traits.inputs
    clips = [open_clip(folder, needs) for folder in parser.parse_args().clips]
    for config, score in search(clips).items():
        sys.stdout.write(f"{score:.2f} dB  {config}\n")


if __name__ == "__main__":
    main()
