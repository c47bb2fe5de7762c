"""Trained weights on disk: a safetensors file in half precision, and its model card in TOML."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors import torch as safetensors
from torch import Tensor, nn

from rlbench.errors import RlbenchError
from rlbench.system import documents, paths

__all__ = [
    "ModelCard",
    "WeightsError",
    "card_path",
    "digest",
    "load_for_inference",
    "load_into",
    "read_card",
    "save",
    "training_clips",
]

DTYPE = torch.float16  # of floating-point weights in the file


class WeightsError(RlbenchError, ValueError):
    """Weights that are missing, changed, or made for another network."""


@dataclass(frozen=True)
class ModelCard:
    """Model card: what weights were trained on, for how long, and with what result.

    `save` fills in `sha256`, `dtype` and `parameters`. Published weights that were not trained here
    have `origin` and no fields of a training.
    """

    name: str  # of the method, as on the command line
    # the clips trained on: name, a space, digest; or names alone, with `data_digest`
    data: tuple[str, ...] = ()
    frames_seen: int = 0  # crops drawn; every frame of every clip in a batch counts
    frames_before: int = 0  # that the weights it started from were trained on, over all starts
    steps: int = 0  # of the optimizer
    seconds: float = 0.0  # training time
    device: str = ""  # that trained
    seed: int = 0
    command: str = ""  # that reproduces the weights
    commit: str = ""  # of the training code
    training_config: str = ""  # the training configuration, JSON
    method_config: str = ""  # the configuration of the method, JSON
    origin: str = ""  # published weights: these, or where training started; empty for random ones
    validation_history: tuple[tuple[int, float], ...] = ()  # (frames seen, PSNR in dB)
    # by validation set: (frames seen, PSNR in dB, PSNR of first frames in dB)
    curves: dict[str, tuple[tuple[int, float, float], ...]] = field(default_factory=dict)
    # by validation set: PSNR of the last quarter of its clips less that of the first, in dB
    drift: dict[str, float] = field(default_factory=dict)
    data_digest: str = ""  # of all clips together, where they are many
    kept_at: int = 0  # frames seen when the weights were these; 0 where that is not known
    trend: str = ""  # of the last validations: "rising" or "flat"; empty where that is not known
    note: str = ""
    licence: str = "Apache-2.0"
    sha256: str = ""  # of the safetensors file
    dtype: str = ""  # of the stored weights
    parameters: int = 0  # number of values in the file

    @property
    def frames_trained(self) -> int:
        """Frames of all trainings that led to these weights, over all starts."""
        return self.frames_before + self.frames_seen


def card_path(path: Path) -> Path:
    """The path of the model card for a weights file.

    >>> card_path(Path("cards/oidn.safetensors")).name
    'oidn.toml'
    """
    return path.with_suffix(".toml")


def digest(path: Path) -> str:
    """SHA-256 of a file, in hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def save(weights: nn.Module | Mapping[str, Tensor], path: Path, card: ModelCard) -> ModelCard:
    """Write the weights of a module, or named ones, with their model card; returns it completed.

    Each of the two files is written atomically. If the process is killed between them, `load_into`
    refuses the pair. Raises WeightsError for weights outside the range of float16.
    """
    named = weights.state_dict() if isinstance(weights, nn.Module) else weights
    tensors = {name: _to_half(name, tensor) for name, tensor in named.items()}
    content = safetensors.save(tensors)
    card = replace(
        card,
        sha256=hashlib.sha256(content).hexdigest(),
        dtype=str(DTYPE).removeprefix("torch."),
        parameters=sum(tensor.numel() for tensor in tensors.values()),
    )
    with paths.atomic_write(path) as temporary:
        temporary.write_bytes(content)
    documents.write_toml(card_path(path), _fields(card))
    return card


def load_for_inference(
    module: nn.Module, weights: str | None, shipped: Path, device: torch.device | str
) -> None:
    """Load pretrained, given or random weights into `module` and prepare it for inference.

    `weights` is what a family's `build` receives: None for the pretrained weights at `shipped`, the
    path of a file, or "random" to keep the initial weights. The module is moved to `device`, set to
    eval mode without gradients, and its weights are laid out channels-last. Raises WeightsError as
    `load_into` does.
    """
    if weights != "random":
        load_into(module, Path(weights) if weights else shipped)
    module.to(device).eval().requires_grad_(False)
    # the memory order in which convolutions are fastest on CPU and GPU, above all in bfloat16
    module.to(memory_format=torch.channels_last)  # type: ignore[call-overload]


def load_into(module: nn.Module, path: Path) -> ModelCard:
    """Load the weights at `path` into `module`, in its own dtype and device; returns their card.

    Raises WeightsError if the file or its card is missing, if the file does not have the hash on
    the card, if the names and shapes are not exactly those of the module, or if a value is NaN or
    infinite.
    """
    card = read_card(path)
    content = path.read_bytes()
    if not content:
        raise WeightsError(f"{path} is empty. {_remedy(card)}")
    if (sha256 := hashlib.sha256(content).hexdigest()) != card.sha256:
        raise WeightsError(
            f"{path} has hash {sha256[:12]}, but its card says {card.sha256[:12]}: one of the two "
            f"files was changed. {_remedy(card)}"
        )
    try:
        tensors = safetensors.load(content)
    except SafetensorError as error:
        raise WeightsError(f"{path} is not a safetensors file: {error}") from error
    _check_shapes(path, _shapes(tensors), _shapes(module.state_dict()))
    _check_finite(path, tensors)
    module.load_state_dict(tensors)
    return card


def read_card(path: Path) -> ModelCard:
    """Read the model card of the weights at `path`.

    Raises WeightsError if one of the two files is missing, or if the card is not TOML, has unknown
    fields, lacks `name` or `sha256`, or has a value of another type.
    """
    file = card_path(path)
    for required in (path, file):
        if required.is_dir():
            raise WeightsError(f"{required} is a folder, not a file of weights or their card")
        if not required.is_file():
            raise WeightsError(
                f"{required} is missing. Train the weights with 'rlbench train', or select others "
                "with 'rlbench run --weights FILE'"
            )
    try:
        document = documents.read_toml(file)
        if unknown := documents.unknown_keys(document, ModelCard):
            raise ValueError(f"unknown fields: {', '.join(unknown)}")
        if missing := sorted({"name", "sha256"} - document.keys()):
            raise ValueError(f"missing fields: {', '.join(missing)}")
        return documents.decode(document, ModelCard)
    except ValueError as error:
        raise WeightsError(f"{file} is not a model card: {error}") from error


def training_clips(path: Path | None) -> frozenset[str]:
    """Names of the clips that the weights at `path` were trained on, according to their card.

    Empty without weights (None) and without a readable card.
    """
    try:
        card = read_card(path) if path else None
    except WeightsError:
        card = None
    if card is None or card.data_digest:
        return frozenset(card.data if card else ())
    return frozenset(clip.rpartition(" ")[0] or clip for clip in card.data)


def _fields(card: ModelCard) -> dict[str, Any]:
    """What the file of a card holds: empty fields are left out if nothing was trained."""
    document = asdict(card)
    return document if card.steps else {key: value for key, value in document.items() if value}


def _remedy(card: ModelCard) -> str:
    is_published = card.origin and not card.steps
    train_again = f"Train again with 'rlbench train --methods {card.name}'"
    return f"Restore both files, or repeat '{card.command}'" if is_published else train_again


def _shapes(tensors: Mapping[str, Tensor]) -> dict[str, list[int]]:
    return {name: list(tensor.shape) for name, tensor in tensors.items()}


def _check_shapes(
    path: Path, stored: Mapping[str, list[int]], expected: Mapping[str, list[int]]
) -> None:
    missing = sorted(expected.keys() - stored.keys())
    unexpected = sorted(stored.keys() - expected.keys())
    if missing or unexpected:
        raise WeightsError(
            f"{path} was saved from another network: missing {missing or 'nothing'}, "
            f"unexpected {unexpected or 'nothing'}"
        )
    for name, shape in expected.items():
        if stored[name] != shape:
            raise WeightsError(
                f"{path} was saved from another network: '{name}' has shape {stored[name]}, "
                f"expected {shape}"
            )


def _check_finite(path: Path, tensors: Mapping[str, Tensor]) -> None:
    for name, tensor in tensors.items():
        if count := tensor.numel() - int(torch.isfinite(tensor).sum()):
            raise WeightsError(
                f"{path}: tensor '{name}' has {count} of {tensor.numel()} values that are NaN or "
                "infinite, so every image would be. Train again with 'rlbench train', or select "
                "other weights with 'rlbench run --weights FILE'"
            )


def _to_half(name: str, tensor: Tensor) -> Tensor:
    tensor = tensor.detach().cpu()
    if tensor.is_floating_point():
        tensor = tensor.to(DTYPE)
        if not torch.isfinite(tensor).all():
            raise WeightsError(f"'{name}' has values that float16 cannot hold, or not finite ones")
    return tensor.contiguous().clone()
