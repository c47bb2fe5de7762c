"""Weights whose sampler acts less: the value before its tanh is multiplied by a factor.

Command: python -m methods.ours.experiments.scale_sampler WEIGHTS OUT --factor 0.5

`correction` measures which factor pays. All other weights stay as they are.
"""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from safetensors import torch as safetensors

from rlbench.errors import RlbenchError
from rlbench.weights import ModelCard, WeightsError, read_card, save

PROGRAM = "python -m methods.ours.experiments.scale_sampler"
LAST_LAYER = ("sampler.last.weight", "sampler.last.bias")


def scale_sampler(weights: Path, out: Path, factor: float, command: str) -> ModelCard:
    """Write the weights with the sampler's last layer times `factor`, and a card that says so.

    Raises WeightsError if the file or its card is missing, or if it has no sampler.
    """
    card = read_card(weights)
    tensors = safetensors.load_file(weights)
    if missing := [name for name in LAST_LAYER if name not in tensors]:
        raise WeightsError(f"{weights} has no sampler: it lacks {', '.join(missing)}")
    scaled = tensors | {name: factor * tensors[name].float() for name in LAST_LAYER}
    note = f"{card.note} The sampler's action before tanh is multiplied by {factor:g}.".strip()
    command = f"{card.command} && {command}" if card.command else command
    return save(scaled, out, replace(card, command=command, note=note))


def main(argv: Sequence[str] | None = None) -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(
        prog=PROGRAM,
        description=__doc__.splitlines()[0],
        epilog=f"example: {PROGRAM} runs/ours/ours.safetensors ours.safetensors --factor 0.5",
    )
    parser.add_argument("weights", type=Path, help="weights of a row with a sampler")
    parser.add_argument("out", type=Path, help="the file to write; its card goes beside it")
    parser.add_argument("--factor", type=float, default=0.5, help="default: 0.5")
    given = list(sys.argv[1:] if argv is None else argv)
    arguments = parser.parse_args(given)
    command = shlex.join([*PROGRAM.split(), *given])
    try:
        card = scale_sampler(arguments.weights, arguments.out, arguments.factor, command)
    except RlbenchError as error:
        parser.error(str(error))
    sys.stdout.write(f"{arguments.out}: {card.note}\n")


if __name__ == "__main__":
    main()
