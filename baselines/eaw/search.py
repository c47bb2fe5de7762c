"""Grid search for EAW's filter widths: python -m baselines.eaw.search CLIP-FOLDER..."""

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
    Config(phi_color=light, phi_normal=normal, phi_depth=depth)
    for light in (1.0, 4.0, 16.0, 64.0)
    for normal in (0.01, 0.1, 0.5)
    for depth in (1e-4, 1e-3, 1e-2)
]


def search(clips: Sequence[StoredClip], grid: Sequence[Config] = GRID) -> dict[Config, float]:
    """Mean PSNR in dB of each config over the first frames of `clips`, best first."""
    first_frames = [InMemoryClip(clip.name, clip.scene, "", [clip.frame(0)]) for clip in clips]
    scores = {config: _mean_psnr(Eaw(config), first_frames) for config in grid}
    return dict(sorted(scores.items(), key=lambda item: -item[1]))


def _mean_psnr(method: Eaw, clips: Sequence[InMemoryClip]) -> float:
    psnr = registry.load_plugin("metrics", "psnr")
    scores = []
    for spp in BUDGETS:
        for clip in clips:
            for result in run_clip(method, clip, spp):
                truth = result.frame.reference
                compared = psnr.compare(result.image, truth.half_a, truth.half_b)
                scores.append(float(psnr.score(compared)))
    return sum(scores) / len(scores)


def main() -> None:
    """Print one line per config, best first."""
    parser = argparse.ArgumentParser(
        prog="python -m baselines.eaw.search",
        description="Print the PSNR of EAW for a grid of filter widths, on clips' first frames.",
        epilog="example: python -m baselines.eaw.search ~/.cache/rlbench/clips/train/*",
    )
    parser.add_argument("clips", type=Path, nargs="+", help="clip folders of training scenes")
    inputs = Eaw().traits.inputs
    clips = [open_clip(folder, inputs) for folder in parser.parse_args().clips]
    for config, score in search(clips).items():
        sys.stdout.write(f"{score:.2f} dB  {config}\n")


if __name__ == "__main__":
    main()
