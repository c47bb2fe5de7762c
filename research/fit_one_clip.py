"""Train `ours` on the very clip that is scored: a bound on what any training could give.

Command: python -m research.fit_one_clip FOLDER --frames 900 --max-lr 1e-4
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import torch
from rich.console import Console

from methods.ours.train import config_task
from research.lean_search import CONFIGS, FAMILY
from rlbench import registry
from rlbench.clips.stored import open_clip
from rlbench.method import Method
from rlbench.run import run_clip
from rlbench.training.batches import Batches
from rlbench.training.task import TrainingConfig
from rlbench.training.train_state import TrainState

BUDGETS = (1.0, 4.0)  # samples per pixel, trained and scored
ORDER_SEED = 77  # of the samples that are scored; training draws other orders
INTERVAL = 50  # sequences between scores


def fit(
    folder: Path, name: str, frames: int, max_lr: float, crop: int = 128
) -> Iterator[tuple[int, list[float]]]:
    """Frames trained on and PSNR in dB at each budget: before training, on the way, and after.

    `name` is a configuration of the search; `folder` holds the only clip.
    """
    task = config_task(CONFIGS[name], FAMILY.variants[name].traits, torch.device("cpu"), seed=0)
    config = TrainingConfig(frames, crop=crop, bf16=True)
    state = TrainState(replace(task, max_lr=max_lr), config, "cpu")
    batches = Batches.from_config([folder], config, task.method.traits, "cpu")
    seen = index = 0
    yield seen, score(task.method, state, folder)
    while seen < frames:
        clip = batches.sequence(index)
        spp = BUDGETS[index % len(BUDGETS)]
        state.train_sequence(clip, spp, config.lr_factor(seen / frames), seen / frames)
        seen, index = seen + len(clip), index + 1
        if index % INTERVAL == 0 or seen >= frames:
            yield seen, score(task.method, state, folder)


def score(method: Method, state: TrainState, folder: Path) -> list[float]:
    """PSNR in dB at each budget, the mean over the frames of the clip, with the trained weights."""
    psnr = registry.load_plugin("metrics", "psnr")
    state.networks.eval()
    scores = []
    for spp in BUDGETS:
        clip = open_clip(folder, method.traits.inputs, pool=method.traits.pool, seed=ORDER_SEED)
        frames = []
        for result in run_clip(method, clip, spp):
            truth = result.frame.reference
            frames.append(psnr.score(psnr.compare(result.image, truth.half_a, truth.half_b)))
        scores.append(float(torch.cat(frames).mean()))
    return scores


def main() -> None:
    """Print the scores while it trains."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="clip to train on and to score")
    parser.add_argument("--config", default="latent-0", choices=sorted(CONFIGS))
    parser.add_argument("--frames", type=int, default=900, help="crops to train on")
    parser.add_argument("--max-lr", type=float, default=1e-4)
    options = parser.parse_args()
    for seen, scores in fit(options.folder, options.config, options.frames, options.max_lr):
        text = ", ".join(f"{s:.2f} dB at {b:g} spp" for b, s in zip(BUDGETS, scores, strict=True))
        Console().print(f"{seen} crops: {text}")


if __name__ == "__main__":
    main()
