"""Training the sampler of `ours` alone, behind an encoder and a denoiser that are ready.

Command: python -m methods.ours.experiments.retrain_sampler --by rllib-appo --frames 2000
"""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from rich.console import Console
from rich.progress import Progress
from torch import nn

from methods.ours import FAMILY
from methods.ours.environment import SamplingEnv
from methods.ours.initialization import show_contrast
from methods.ours.method import CARDS, Ours
from methods.ours.networks import Networks, Sampler
from methods.ours.policy import LEARNERS, RLLIB, BlockPolicyGradient, appo, appo_config, learner
from methods.ours.train import BUDGETS
from methods.ours.variants import BASE
from rlbench.ops.init import kaiming_init
from rlbench.system import paths
from rlbench.training import validation
from rlbench.training.batches import Batches
from rlbench.weights import ModelCard, load_for_inference, read_card, save

PEAK, FALL = 1e-3, 0.1  # learning rate at the start, and of it at the end: a line between
NORM = 1.0  # gradients are clipped to this length
REACH = 4  # pixels around one whose errors are credited to it by RLlib


@dataclass(frozen=True)
class Task:
    """What is trained on, and behind which weights. It makes the same world in any process."""

    folders: tuple[Path, ...]
    weights: Path = CARDS / "ours.safetensors"  # whose encoder and denoiser are kept
    crop: int = 128  # side of a crop, pixels
    length: int = 6  # frames of an episode
    seed: int = 0
    floor: int = 0  # samples that every pixel has

    def method(self) -> Ours:
        """`ours` as it trains, with a sampler that knows nothing, and the other networks frozen."""
        networks = Networks(BASE)
        load_for_inference(networks, str(self.weights), self.weights, "cpu")
        networks.sampler = self.sampler().to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        traits = replace(FAMILY.variants[""].traits, min_samples=self.floor)
        return Ours(BASE.training, traits, networks)

    def sampler(self) -> Sampler:
        """A sampler with seeded weights and a uniform density, as every training begins with."""
        made = Sampler(Networks(BASE).foreseen, BASE.sampler, paced=BASE.gathers)
        kaiming_init(made, self.seed)
        show_contrast(made, BASE)
        made.start_uniform()
        return made

    def batches(self) -> Batches:
        """Crops of the clips, one at a time."""
        return Batches(self.folders, 1, self.crop, self.length, self.seed)

    def world(self) -> SamplingEnv:
        """Episodes of crops, at the budgets that `ours` is trained at."""
        budgets = [spp for spp in BUDGETS if spp >= self.floor]
        return SamplingEnv(self.method(), self.batches(), budgets)


def by_torch(
    name: str, task: Task, frames: int, tell: Callable[[int, nn.Module], None]
) -> nn.Module:
    """A step of a learner for every frame; half of the episodes are walked with noisy actions."""
    world = task.world()
    sampler, explorer = world.method.networks.sampler, BlockPolicyGradient()
    assert sampler is not None
    learns = learner(name, world.method.networks.foreseen)
    trained = nn.ModuleList(part for part in (sampler, learns.network) if part is not None)
    optimizer = torch.optim.Adam(trained.parameters(), PEAK)
    generator = torch.Generator().manual_seed(task.seed)
    world.reset()
    noisy = False
    for seen in range(1, frames + 1):
        for group in optimizer.param_groups:
            group["lr"] = PEAK * (1 - (1 - FALL) * seen / frames)
        loss = learns.loss(world.turn, generator)
        optimizer.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        nn.utils.clip_grad_norm_(trained.parameters(), NORM)
        optimizer.step()
        action = world.turn.act().detach()
        if noisy:
            action = explorer.explore(action, explorer.corner(generator), generator)
        if world.step(action).over:
            world.reset()
            noisy = not noisy
        tell(seen, sampler)
    return sampler


def by_rllib(task: Task, frames: int, tell: Callable[[int, nn.Module], None]) -> nn.Module:
    """Ray's own loop, with ratios and credit for single pixels."""
    settings = appo_config.Appo(
        rate=PEAK, reach=REACH, multiplicative=BASE.density == "exponential"
    )
    return appo.train(task.world, task.sampler, frames, settings, task.seed, 100, tell)


def retrain(
    name: str, task: Task, frames: int, validate: list[Path], out: Path, command: str
) -> dict[str, float]:
    """Train, write OUT/NAME.safetensors with its card; returns mean PSNR, uniform and trained."""
    with Progress() as bar:
        row = bar.add_task(name, total=frames)

        def tell(seen: int, sampler: nn.Module) -> None:
            bar.update(row, completed=seen)

        torch_ = name in LEARNERS
        trained = by_torch(name, task, frames, tell) if torch_ else by_rllib(task, frames, tell)
    method = task.method()
    networks = method.networks
    spp = validation.budgets(method, BUDGETS, ())
    told = {"uniform": validation.validate(method, networks, networks, validate, spp, "cpu").psnr}
    assert networks.sampler is not None
    networks.sampler.load_state_dict(trained.state_dict())
    told[name] = validation.validate(method, networks, networks, validate, spp, "cpu").psnr
    card = ModelCard(
        name="ours/A1" if task.floor else "ours",
        data=tuple(dict.fromkeys([*read_card(task.weights).data, *task.batches().clip_digests()])),
        frames_seen=frames,
        seed=task.seed,
        command=command,
        origin=f"encoder and denoiser of {task.weights.name}",
        validation_history=((0, told["uniform"]), (frames, told[name])),
        note=f"sampler alone, by {name}",
    )
    save(networks, out / f"{name}.safetensors", card)
    return told


def main() -> None:
    """Read the command line."""
    known = [*LEARNERS, RLLIB]
    parser = argparse.ArgumentParser(
        prog="python -m methods.ours.experiments.retrain_sampler",
        description="Train the sampler of `ours` alone, from a uniform density, behind the shipped "
        "encoder and denoiser, and write OUT/LEARNER.safetensors, to be scored by 'rlbench run -m "
        "ours --weights LEARNER=FILE' (of surrogate and gamma: -m ours/A1).",
        epilog="example: python -m methods.ours.experiments.retrain_sampler "
        "--by rllib-appo --frames 200 --out /tmp/x",
    )
    parser.add_argument("--by", default="ppo-pixel", choices=known, help="the learner")
    parser.add_argument("--frames", type=int, default=2000, help="crops that are seen")
    parser.add_argument(
        "--clips", type=Path, default=paths.clips() / "train", help="folder of clips"
    )
    parser.add_argument("--crop", type=int, default=128, help="side of a crop, pixels")
    parser.add_argument("--seed", type=int, default=0, help="of crops and draws")
    parser.add_argument("--out", type=Path, default=Path("runs/samplers"), help="folder")
    asked = parser.parse_args()
    clips = sorted(file.parent for file in asked.clips.glob("*/clip.toml"))
    if len(clips) < 3:
        parser.error(
            f"{asked.clips} holds {len(clips)} clips, at least 3 are needed, of which 2 "
            "validate: 'rlbench render --preset train' makes some, --clips takes others"
        )
    validate = clips[:: len(clips) // 2][:2]
    floor = 0 if asked.by == RLLIB else learner(asked.by, 1).floor
    chosen = tuple(clip for clip in clips if clip not in validate)
    task = Task(chosen, crop=asked.crop, seed=asked.seed, floor=floor)
    command = shlex.join(
        ["python", "-m", "methods.ours.experiments.retrain_sampler", *sys.argv[1:]]
    )
    told = retrain(asked.by, task, asked.frames, validate, asked.out, command)
    for row, psnr in told.items():
        Console().print(f"{row}: {psnr:.2f} dB on the validating clips, at 1 and 4 spp")


if __name__ == "__main__":
    main()
