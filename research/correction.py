"""How much of the learned density gains: the sampler's action, scaled from the rule to itself.

Command: python -m research.correction CLIPS --spp 0.25,0.5,1,2,4

At scale 0 the density is that of the contrast rule, at 1 that of `ours`. Networks are the same.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd
from jaxtyping import Float
from rich.progress import track
from torch import Tensor

from methods.ours.history import RecurrentState
from methods.ours.method import Ours
from research.clips import add_clips, print_gains, read_cells
from rlbench import registry
from rlbench.frames import GBuffer, Samples
from rlbench.training.train_state import validate
from rlbench.wrappers import MethodWrapper

PROGRAM = "python -m research.correction"
SCALES = (0.0, 0.25, 0.5, 1.0)


@dataclass(frozen=True)
class ScaledAction(MethodWrapper[Ours]):
    """`ours`, whose sampler's action is multiplied by `scale`."""

    scale: float = 1.0

    def plan(
        self, gbuffer: GBuffer, samples: Samples, state: RecurrentState
    ) -> Float[Tensor, "n 1 h w"]:
        """The density of the scaled action."""
        action = self.scale * self.method.act(gbuffer, state)
        return self.method.to_density(action, gbuffer, state)


def measure_clip(folder: Path, spp: float, scales: Sequence[float]) -> Iterator[dict[str, object]]:
    """PSNR in dB at each scale, the mean over the frames of a clip."""
    method = registry.load_method("ours", "cpu")
    assert isinstance(method, Ours)
    for scale in scales:
        scaled = ScaledAction(method, scale)
        psnr = validate(scaled, {folder.name: [folder]}, [spp], "cpu").psnr
        yield {"clip": folder.name, "spp": spp, "scale": scale, "psnr": psnr}


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(
        prog=PROGRAM,
        description="PSNR of `ours` over the contrast rule, in dB, by scale of its correction.",
    )
    add_clips(parser)
    cells = read_cells(parser, parser.parse_args())
    rows = [row for cell in track(cells, "measuring") for row in measure_clip(*cell, SCALES)]
    table = pd.DataFrame(rows).pivot_table(index="scale", columns="spp", values="psnr")
    print_gains("scale", table - table.loc[0.0])


if __name__ == "__main__":
    main()
