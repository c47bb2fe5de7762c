"""Average weights of one network: python -m rlbench.training.average OUT SHARE*FILE SHARE*FILE.

Networks that were fine-tuned from one start can be averaged weight by weight: their mean is often
better than each, and a share of the start keeps what it knew (Wortsman et al. 2022, Model soups;
Wortsman et al. 2022, Robust fine-tuning of zero-shot models).
"""

from __future__ import annotations

import argparse
import math
import shlex
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from safetensors import torch as safetensors
from torch import Tensor

from rlbench.errors import RlbenchError
from rlbench.weights import ModelCard, WeightsError, read_card, save

TOLERANCE = 1e-6  # of the sum of all shares


def average_weights(parts: Sequence[tuple[float, Path]], out: Path, command: str) -> ModelCard:
    """Write the weighted mean of weights files, with a card that names them; returns the card.

    `parts` are shares, which sum to 1, and files. The card has the name, curves and time of the
    last file, the origin of the first, clips and frames of all, and `command`. Raises WeightsError
    if a file or its card is missing, if names or shapes differ, or if the shares do not sum to 1.
    """
    if abs(math.fsum(share for share, _ in parts) - 1) > TOLERANCE:
        shares = " + ".join(f"{share:g}" for share, _ in parts)
        raise WeightsError(f"the shares {shares} do not sum to 1")
    cards = [read_card(path) for _, path in parts]
    files = [safetensors.load_file(path) for _, path in parts]
    for (_, path), tensors in zip(parts, files, strict=True):
        if _shapes(tensors) != _shapes(files[0]):
            raise WeightsError(f"{path} has other tensors than {parts[0][1]}: they have no average")
    mean = {
        name: sum(
            share * file[name].double() for (share, _), file in zip(parts, files, strict=True)
        )
        for name in files[0]
    }
    names = [
        f"{share:g} of {card.name}" + (f" ({card.command})" if card.command else "")
        for (share, _), card in zip(parts, cards, strict=True)
    ]
    card = replace(
        cards[-1],
        data=tuple(dict.fromkeys(clip for card in cards for clip in card.data)),
        frames_seen=sum(card.frames_seen for card in cards),  # parts may share a start
        frames_before=0,
        kept_at=0,
        trend="",
        command=command,
        origin=cards[0].origin,
        note=f"Weighted mean of weights: {', '.join(names)}. Curves and time are of the last.",
    )
    return save(mean, out, card)


def _shapes(tensors: dict[str, Tensor]) -> dict[str, tuple[int, ...]]:
    return {name: tuple(tensor.shape) for name, tensor in tensors.items()}


def main(argv: Sequence[str] | None = None) -> str:
    """What was written by the given command-line arguments."""
    parser = argparse.ArgumentParser(
        "python -m rlbench.training.average",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        epilog="example:\n  python -m rlbench.training.average averaged.safetensors "
        "0.5*runs/ntas/ntas.safetensors 0.5*runs/longer/ntas.safetensors",
    )
    parser.add_argument("out", type=Path, help="the file to write; its card goes beside it")
    parser.add_argument("parts", nargs="+", metavar="SHARE*FILE", help="shares sum to 1")
    arguments = parser.parse_args(argv)
    command = shlex.join(["python", "-m", "rlbench.training.average", *(argv or sys.argv[1:])])
    try:
        parts = [_read_part(text) for text in arguments.parts]
        card = average_weights(parts, arguments.out, command)
    except RlbenchError as error:
        parser.error(str(error))
    return f"{arguments.out}: {card.note}"


def _read_part(text: str) -> tuple[float, Path]:
    share, star, file = text.partition("*")
    try:
        if not star:
            raise ValueError
        return float(share), Path(file)
    except ValueError:
        raise WeightsError(f"'{text}' is not SHARE*FILE, such as 0.5*weights.safetensors") from None


if __name__ == "__main__":
    sys.stdout.write(main() + "\n")
