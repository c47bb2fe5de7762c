"""Train the sampler of `ours` or `ours/paper` alone, behind the shipped encoder and denoiser.

Command: python -m research.retrain_sampler --by rllib-appo --frames 2000
"""

from __future__ import annotations

import shlex
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from rich.console import Console
from rich.progress import Progress
from torch import nn

from methods.ours import FAMILY, VARIANTS, Config
from methods.ours.gradients.command import Options, make_parser
from methods.ours.initialization import wire_contrast
from methods.ours.method import CARDS, Ours, assemble
from methods.ours.networks import Networks, Sampler
from methods.ours.policy import LEARNERS, RLLIB_APPO, BlockPolicyGradient, appo, make_learner
from methods.ours.problem import SamplingEnv
from rlbench.ops.init import kaiming_init
from rlbench.system import paths
from rlbench.training.batches import Batches
from rlbench.training.task import BUDGETS_FROM_0_05_SPP
from rlbench.training.train_state import validate, validation_budgets
from rlbench.weights import ModelCard, load_for_inference, read_card, save

PROGRAM = "python -m research.retrain_sampler"
MAX_LR, FINAL_SHARE = 1e-3, 0.1  # learning rate at the start, and its share at the end; linear
MAX_GRAD_NORM = 1.0
RLLIB_REACH = 4  # pixels around one whose errors RLlib's learner credits to it

OnProgress = Callable[[int, nn.Module], None]  # frames so far, sampler


@dataclass(frozen=True)
class SamplerTask:
    """The clips and weights of one training. It makes the same environment in any process."""

    folders: tuple[Path, ...]  # clips
    weights: Path = CARDS / "ours.safetensors"  # of encoder and denoiser
    variant: str = ""  # whose weights these are: "" or "paper"
    one_policy: bool = False  # RLlib's APPO as in the paper: one ratio and reward a frame
    crop: int = 128  # pixels, side of a crop
    length: int = 6  # frames of an episode
    seed: int = 0
    min_samples: int = 0  # of each pixel

    @property
    def config(self) -> Config:
        """The settings of the variant."""
        return VARIANTS[self.variant]

    @property
    def scored_as(self) -> str:
        """The method that the weights belong to: A1 gives every pixel a sample."""
        names = [self.variant, "A1" * bool(self.min_samples)]
        key = "-".join(filter(None, names))
        return f"ours/{key}" if key else "ours"

    def make_method(self) -> Ours:
        """The method during training: an untrained sampler, and the other networks frozen."""
        networks = Networks(self.config)
        load_for_inference(networks, str(self.weights), self.weights, "cpu")
        sampler = self.make_sampler()
        networks.sampler = sampler.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        traits = replace(FAMILY.variants[self.variant].traits, min_samples=self.min_samples)
        return assemble(self.config.for_training, traits, networks)

    def make_sampler(self) -> Sampler:
        """A sampler with the first weights of every training: seeded, and its actions 0."""
        config = self.config
        sampler = Networks(config).sampler
        assert sampler is not None
        kaiming_init(sampler, self.seed)
        if config.wired_contrast:
            wire_contrast(sampler, config)
        sampler.start_uniform()
        return sampler

    def make_batches(self) -> Batches:
        """Crops of the clips, one at a time."""
        return Batches(self.folders, 1, self.crop, self.length, self.seed)

    def make_env(self) -> SamplingEnv:
        """Episodes of crops, at the budgets that `ours` is trained at."""
        budgets = [spp for spp in BUDGETS_FROM_0_05_SPP if spp >= self.min_samples]
        return SamplingEnv(self.make_method(), self.make_batches(), budgets)


def train_by_learner(
    name: str, task: SamplerTask, frames: int, on_progress: OnProgress
) -> nn.Module:
    """The sampler after one step of a learner for every frame; every second episode is noisy."""
    env = task.make_env()
    sampler, policy = env.method.sampler, BlockPolicyGradient()
    assert sampler is not None
    learner = make_learner(name, env.method.networks.sampler_channels)
    parts = nn.ModuleList(part for part in (sampler, learner.network) if part is not None)
    optimizer = torch.optim.Adam(parts.parameters(), MAX_LR)
    generator = torch.Generator().manual_seed(task.seed)
    env.reset()
    noisy = False
    for done in range(1, frames + 1):
        for group in optimizer.param_groups:
            group["lr"] = MAX_LR * (1 - (1 - FINAL_SHARE) * done / frames)
        loss = learner.loss(env.problem, generator)
        optimizer.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        nn.utils.clip_grad_norm_(parts.parameters(), MAX_GRAD_NORM)
        optimizer.step()
        action = env.problem.act().detach()
        if noisy:
            action = policy.explore(action, policy.draw_corner(generator), generator)
        if env.step(action).truncated:
            env.reset()
            noisy = not noisy
        on_progress(done, sampler)
    return sampler


def train_by_rllib(task: SamplerTask, frames: int, on_progress: OnProgress) -> nn.Module:
    """The sampler after a training in RLlib's loop.

    Ratios and credit are those of single pixels, or of the image if `task.one_policy`.
    """
    settings = appo.AppoSettings(
        joint_ratio=task.one_policy,
        learning_rate=MAX_LR,
        reach=RLLIB_REACH,
        multiplicative=task.config.density == "exponential",
    )
    make_sampler = task.make_sampler
    return appo.train(task.make_env, make_sampler, frames, settings, task.seed, 100, on_progress)


def retrain(
    name: str,
    task: SamplerTask,
    frames: int,
    validation_clips: list[Path],
    out: Path,
    command: str,
) -> dict[str, float]:
    """Train, and write OUT/NAME.safetensors with its card.

    Returns the mean validation PSNR in dB, under "untrained" and under the learner's name.
    """
    with Progress() as progress:
        bar = progress.add_task(name, total=frames)

        def on_progress(done: int, sampler: nn.Module) -> None:
            progress.update(bar, completed=done)

        if name == RLLIB_APPO:
            sampler = train_by_rllib(task, frames, on_progress)
        else:
            sampler = train_by_learner(name, task, frames, on_progress)
    method = task.make_method()
    networks = method.networks
    spp = validation_budgets(method, BUDGETS_FROM_0_05_SPP, ())
    assert networks.sampler is not None
    scored = (method, {"validation": validation_clips}, spp, "cpu")
    psnr = {"untrained": validate(*scored).psnr}
    networks.sampler.load_state_dict(sampler.state_dict())
    psnr[name] = validate(*scored).psnr
    save(networks, out / f"{name}.safetensors", _card(name, task, frames, psnr, command))
    return psnr


def _card(
    name: str, task: SamplerTask, frames: int, psnr: dict[str, float], command: str
) -> ModelCard:
    return ModelCard(
        name=task.scored_as,
        data=tuple(
            dict.fromkeys([*read_card(task.weights).data, *task.make_batches().clip_digests()])
        ),
        frames_seen=frames,
        seed=task.seed,
        command=command,
        origin=f"all but the sampler of {task.weights.name}",
        validation_history=((0, psnr["untrained"]), (frames, psnr[name])),
        note=f"sampler alone, by {name}" + ", one policy over the image" * task.one_policy,
    )


DESCRIPTION = """Train the sampler of `ours` or `ours/paper` alone, from weights that request the
density of the contrast rule (`ours`) or a uniform one (`ours/paper`), behind the shipped encoder
and denoiser. Write OUT/LEARNER.safetensors, and print the PSNR on two validation clips.

Score the weights: rlbench run -m ours --weights LEARNER=FILE
(for surrogate and gamma: -m ours/A1)."""
EXAMPLES = (
    "--by reinforce",
    "--by rllib-appo --frames 200 --out /tmp/x",
    "--by rllib-appo --variant paper --one-policy",
)
OPTIONS: Options = {
    "--by": ("reinforce", f"learner, one of: {', '.join([*LEARNERS, RLLIB_APPO])}"),
    "--variant": ("", "paper: train the sampler of ours/paper, and not that of ours"),
    "--one-policy": (
        False,
        "with rllib-appo: one ratio and one reward for the image, as in the paper",
    ),
    "--frames": (2000, "crops to train on"),
    "--crop": (128, "pixels, side of a crop"),
    "--seed": (0, "of crops and actions"),
    "--out": (Path("runs/samplers"), "folder"),
}


def main() -> None:
    """Run the command line."""
    options = {**OPTIONS, "--clips": (paths.clips_folder() / "train", "folder of clips")}
    parser = make_parser(PROGRAM, DESCRIPTION, EXAMPLES, options)
    arguments = parser.parse_args()
    for option, value, known in (
        ("--by", arguments.by, [*LEARNERS, RLLIB_APPO]),
        ("--variant", arguments.variant, ["", "paper"]),
    ):
        if value not in known:
            parser.error(f"{option} {value}: choose one of: {', '.join(filter(None, known))}")
    clips = sorted(file.parent for file in arguments.clips.glob("*/clip.toml"))
    if len(clips) < 3:
        parser.error(
            f"--clips {arguments.clips}: 3 clips or more are needed, 2 of them for validation, and "
            f"the folder has {len(clips)}. Render some with 'rlbench render --preset train', or "
            "choose another folder"
        )
    validate = clips[:: len(clips) // 2][:2]
    task = SamplerTask(
        tuple(clip for clip in clips if clip not in validate),
        weights=CARDS / FAMILY.weights_file(arguments.variant),
        variant=arguments.variant,
        one_policy=arguments.one_policy,
        crop=arguments.crop,
        seed=arguments.seed,
        min_samples=0 if arguments.by == RLLIB_APPO else make_learner(arguments.by, 1).min_samples,
    )
    command = shlex.join([*PROGRAM.split(), *sys.argv[1:]])
    for row, psnr in retrain(
        arguments.by, task, arguments.frames, validate, arguments.out, command
    ).items():
        Console().print(f"{row}: {psnr:.2f} dB on the validation clips, mean of 1 and 4 spp")


if __name__ == "__main__":
    main()
