"""LPIPS with AlexNet, by its authors' package `lpips`, which holds the weights of its last layer.

The weights of AlexNet are a download of PyTorch's model zoo. They are read from a file, and nothing
is downloaded here.
"""

from __future__ import annotations

import hashlib
import math
import os
from functools import cache
from pathlib import Path
from typing import Any

from metrics.metric import Comparison, Metric

__all__ = ["LPIPS", "WEIGHTS_VARIABLE", "LpipsWeightsError", "load_network", "lpips"]

Tensor = Any  # torch.Tensor

WEIGHTS_VARIABLE = "RLBENCH_LPIPS_WEIGHTS"  # the file of AlexNet's weights
WEIGHTS_FILE = "alexnet-owt-7be5be79.pth"  # of torchvision; ends with its SHA-256's first 8 digits
MIN_SIDE = 31  # pixels; AlexNet's last layers vanish below


class LpipsWeightsError(RuntimeError):
    """The file of AlexNet's weights is missing, or it is another one."""


def lpips(comparison: Comparison) -> Tensor:
    """Distance of deep features of clipped sRGB, [n]; lower is better, 0 for equal images.

    Zhang et al. 2018, The Unreasonable Effectiveness of Deep Features as a Perceptual Metric:
    squared differences of AlexNet's normalised features, weighted by version 0.1 of its linear
    layer. NaN where a side is below 31 pixels. A pixel that is not finite is black or white,
    whichever is further from the reference.

    Raises LpipsWeightsError.
    """
    import torch

    image, reference = comparison.display_image, comparison.display_reference
    if min(image.shape[-2:]) < MIN_SIDE:
        return image.new_full(image.shape[:1], math.nan)
    network = load_network(_weights_file()).to(image.device)
    with torch.no_grad():
        distances: Tensor = network(image, reference, normalize=True)  # from [0, 1] to [-1, 1]
    return distances[:, 0, 0, 0]


@cache
def load_network(file: Path) -> Any:
    """LPIPS with the AlexNet of a file, a dictionary of tensors as torchvision names them."""
    import lpips as package
    import torch

    network = package.LPIPS(net="alex", pnet_rand=True, verbose=False)
    stored = torch.load(file, map_location="cpu", weights_only=True)
    names = {name: f"features.{name.partition('.')[2]}" for name in network.net.state_dict()}
    network.net.load_state_dict({name: stored[stored_name] for name, stored_name in names.items()})
    return network.eval()


def _weights_file() -> Path:
    """The file that the user names, else the one in torch's cache."""
    import torch

    default = Path(torch.hub.get_dir()) / "checkpoints" / WEIGHTS_FILE
    file = Path(os.environ.get(WEIGHTS_VARIABLE, default))
    expected = WEIGHTS_FILE.rpartition("-")[2].partition(".")[0]
    if not file.is_file():
        raise LpipsWeightsError(
            f"LPIPS needs AlexNet's weights, and {file} does not exist. Download "
            f"https://download.pytorch.org/models/{WEIGHTS_FILE} there, or set {WEIGHTS_VARIABLE} "
            "to the file"
        )
    if not _sha256(file).startswith(expected):
        raise LpipsWeightsError(
            f"{file} is not {WEIGHTS_FILE}: its SHA-256 begins with {_sha256(file)[:8]}, not with "
            f"{expected}. Download https://download.pytorch.org/models/{WEIGHTS_FILE}"
        )
    return file


@cache
def _sha256(file: Path) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest()


LPIPS = Metric(
    name="lpips",
    unit="",
    direction="lower",
    convention="LPIPS 0.1 of clipped sRGB in float, AlexNet of torchvision; undefined below 31 "
    "pixels",
    score=lpips,
    source="Zhang et al. 2018",
    requires=("lpips",),
    scored_by_run=False,
)
