"""Edit weights of `ours`: its denoiser before training, or a sampler that acts less.

Commands:

    python -m research.edit_weights initial-denoiser WEIGHTS OUT
    python -m research.edit_weights scale-sampler WEIGHTS OUT --factor 0.5

The first is a part for `rlbench.training.average`: a share of the start keeps what Intel's weights
know. `correction` compares factors of the second. All other weights stay as they are.
"""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import torch
from safetensors import torch as safetensors
from torch import Tensor

from methods.ours.train import training_task
from rlbench.errors import RlbenchError
from rlbench.weights import ModelCard, WeightsError, read_card, save

PROGRAM = "python -m research.edit_weights"
LAST_LAYER = ("sampler.last.weight", "sampler.last.bias")
Weights = Mapping[str, Tensor]


def initial_denoiser(tensors: Weights, card: ModelCard) -> tuple[Weights, ModelCard]:
    """The weights with the denoiser as it was before training.

    Raises WeightsError if they are not of a row of `ours`.
    """
    family, _, variant = card.name.partition("/")
    if family != "ours":
        raise WeightsError(f"'{card.name}' is not a row of ours")
    task = training_task(variant, torch.device("cpu"), card.seed)
    first = task.networks.state_dict()
    names = [name for name in tensors if name.startswith("denoiser.")]
    edited = {**tensors, **{name: first[name] for name in names}}
    note = "The denoiser is untrained."
    return edited, replace(card, origin=task.origin, frames_seen=0, note=note)


def scale_sampler(tensors: Weights, card: ModelCard, factor: float) -> tuple[Weights, ModelCard]:
    """The weights with the value before the sampler's tanh multiplied by `factor`.

    Raises WeightsError if they have no sampler.
    """
    if missing := [name for name in LAST_LAYER if name not in tensors]:
        raise WeightsError(f"'{card.name}' has no sampler: it lacks {', '.join(missing)}")
    edited = {**tensors, **{name: factor * tensors[name].float() for name in LAST_LAYER}}
    note = f"{card.note} The sampler's action before tanh is multiplied by {factor:g}."
    return edited, replace(card, note=note.strip())


def main(argv: Sequence[str] | None = None) -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(
        prog=PROGRAM,
        description="Edit weights of ours.",
        epilog=f"example: {PROGRAM} scale-sampler runs/ours/ours.safetensors half.safetensors",
    )
    commands = parser.add_subparsers(dest="command", required=True)
    initial = commands.add_parser("initial-denoiser", help="the denoiser before training")
    scale = commands.add_parser("scale-sampler", help="a sampler that acts less")
    for each in (initial, scale):
        each.add_argument("weights", type=Path, help="a weights file with its card beside it")
        each.add_argument("out", type=Path, help="the file to write; its card goes beside it")
    scale.add_argument("--factor", type=float, default=0.5, help="default: 0.5")
    given = list(sys.argv[1:] if argv is None else argv)
    arguments = parser.parse_args(given)
    edit: Callable[[Weights, ModelCard], tuple[Weights, ModelCard]] = initial_denoiser
    if arguments.command == "scale-sampler":
        edit = partial(scale_sampler, factor=arguments.factor)
    try:
        card = read_card(arguments.weights)
        tensors, edited = edit(safetensors.load_file(arguments.weights), card)
        line = shlex.join([*PROGRAM.split(), *given])
        past = f"{card.command} && {line}" if card.command else line
        save(tensors, arguments.out, replace(edited, command=past))
    except RlbenchError as error:
        parser.error(str(error))
    sys.stdout.write(f"{arguments.out}: {edited.note}\n")


if __name__ == "__main__":
    main()
