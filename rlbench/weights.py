"""Trained weights on disk: half floats in a safetensors file, and a card that says whence."""

from __future__ import annotations

import hashlib
import json
import tomllib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors import torch as safetensors
from torch import Tensor, nn

from rlbench.errors import RlbenchError
from rlbench.system import paths

DTYPE = torch.float16  # of floating weights in the file


class WeightsError(RlbenchError, ValueError):
    """Weights that are missing, changed, or not those of the network."""


@dataclass(frozen=True)
class ModelCard:
    """Where weights come from: what they were trained on, for how long, and how well it went.

    `save` fills in sha256, dtype and parameters.
    """

    name: str  # of the method, as on the command line
    data: tuple[str, ...] = ()  # names or digests of the clips trained on
    frames_seen: int = 0  # crops, each frame of each clip in a batch counts
    steps: int = 0  # of the optimiser
    seconds: float = 0.0  # of training
    device: str = ""  # trained on
    seed: int = 0
    command: str = ""  # that makes these weights again
    commit: str = ""  # of the code that trained them
    plan: str = ""  # how long and at what rate, JSON
    config: str = ""  # of the method, JSON
    origin: str = ""  # what training started from; empty for random weights
    curve: tuple[tuple[int, float], ...] = ()  # frames seen, validation PSNR in dB
    note: str = ""
    licence: str = "Apache-2.0"
    sha256: str = ""  # of the safetensors file
    dtype: str = ""  # of the stored weights
    parameters: int = 0  # numbers in the file


def card_path(path: Path) -> Path:
    """The card that lies beside a weights file."""
    return path.with_suffix(".toml")


def digest(path: Path) -> str:
    """SHA-256 of a file, in hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def save(module: nn.Module, path: Path, card: ModelCard) -> ModelCard:
    """Write the weights of `module` to `path`, and their card beside it; returns the whole card.

    Each file is written under another name and renamed; a kill between the two leaves a pair that
    `load_into` refuses. Raises WeightsError for weights that half floats cannot hold.
    """
    stored = {name: _half(name, tensor) for name, tensor in module.state_dict().items()}
    content = safetensors.save(stored)
    card = replace(
        card,
        sha256=hashlib.sha256(content).hexdigest(),
        dtype=str(DTYPE).removeprefix("torch."),
        parameters=sum(tensor.numel() for tensor in stored.values()),
    )
    for place, told in ((path, content), (card_path(path), _toml(asdict(card)).encode())):
        with paths.replacing(place) as temporary:
            temporary.write_bytes(told)
    return card


def load_for_inference(
    module: nn.Module, asked: str | None, shipped: Path, device: torch.device | str
) -> None:
    """Make a network ready to run, with the weights that a family's `build` is asked for.

    `asked` is the path of a file, or None for those `shipped`, or "random" for those it has. Raises
    WeightsError as `load_into` does.
    """
    if asked != "random":
        load_into(module, Path(asked) if asked else shipped)
    module.to(device).eval().requires_grad_(False)
    # the order in which convolutions are fastest, on CPU and GPU; most in half precision
    module.to(memory_format=torch.channels_last)  # type: ignore[call-overload]


def load_into(module: nn.Module, path: Path) -> ModelCard:
    """Put the weights at `path` into `module`, in its own dtype and device; returns their card.

    Raises WeightsError where the file or its card is missing, where the file is not the one the
    card was written for, or where names or shapes are not exactly those of the module.
    """
    card = read_card(path)
    content = path.read_bytes()
    if (found := hashlib.sha256(content).hexdigest()) != card.sha256:
        raise WeightsError(
            f"{path} has hash {found[:12]}, its card says {card.sha256[:12]}: "
            f"one of them was changed; {_remedy(card.name)}"
        )
    try:
        stored = safetensors.load(content)
    except SafetensorError as error:
        raise WeightsError(f"{path} is not a safetensors file: {error}") from error
    _check(path, {k: v.shape for k, v in stored.items()}, _shapes(module))
    module.load_state_dict(stored)
    return card


def read_card(path: Path) -> ModelCard:
    """The card beside the weights at `path`; raises WeightsError where either is missing."""
    for needed in (path, card_path(path)):
        if not needed.is_file():
            raise WeightsError(
                f"no weights: {needed} is missing; 'rlbench train' makes them, and 'rlbench run "
                "--weights FILE' takes them"
            )
    try:
        found = tomllib.loads(card_path(path).read_text())
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise WeightsError(f"{card_path(path)} is not a card: {error}") from error
    known = {field.name for field in fields(ModelCard)}
    if unknown := sorted(found.keys() - known):
        raise WeightsError(f"{card_path(path)} has unknown fields: {', '.join(unknown)}")
    if absent := sorted({"name", "sha256"} - found.keys()):
        raise WeightsError(f"{card_path(path)} lacks: {', '.join(absent)}")
    found["data"] = tuple(found.get("data", ()))
    found["curve"] = tuple((int(seen), float(psnr)) for seen, psnr in found.get("curve", ()))
    return ModelCard(**found)


def _remedy(name: str) -> str:
    return f"'rlbench train --methods {name}' makes it"


def _shapes(module: nn.Module) -> dict[str, torch.Size]:
    return {name: tensor.shape for name, tensor in module.state_dict().items()}


def _check(path: Path, found: Mapping[str, torch.Size], wanted: Mapping[str, torch.Size]) -> None:
    missing = sorted(wanted.keys() - found.keys())
    unexpected = sorted(found.keys() - wanted.keys())
    if missing or unexpected:
        raise WeightsError(
            f"{path} is of another network: missing {missing or 'nothing'}, "
            f"unexpected {unexpected or 'nothing'}"
        )
    for name, shape in wanted.items():
        if found[name] != shape:
            raise WeightsError(
                f"{path} is of another network: '{name}' has shape {list(found[name])}, "
                f"wanted {list(shape)}"
            )


def _half(name: str, tensor: Tensor) -> Tensor:
    tensor = tensor.detach().cpu()
    if tensor.is_floating_point():
        tensor = tensor.to(DTYPE)
        if not torch.isfinite(tensor).all():
            raise WeightsError(f"'{name}' has values that half floats cannot hold, or not finite")
    return tensor.contiguous().clone()


def _toml(values: Mapping[str, Any]) -> str:
    """Strings, numbers and (nested) lists of them, a line each; as JSON, which TOML reads here."""
    lines = (f"{key} = {json.dumps(value)}" for key, value in values.items())
    return "\n".join(lines).replace("\x7f", "\\u007f") + "\n"
