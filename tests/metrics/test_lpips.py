"""LPIPS: the network around any AlexNet, against a twin of plain operations; and its weights file.

The trained weights are a download and are not here, so no published distance is tested.
"""

from __future__ import annotations

import importlib.resources
import math

import pytest
import torch
import torch.nn.functional as F

from metrics import lpips as module
from metrics.lpips import LPIPS, LpipsWeightsError, load_network
from tests.metrics.deep_packages import import_or_skip

LAYERS = {0: (64, 3, 11), 3: (192, 64, 5), 6: (384, 192, 3), 8: (256, 384, 3), 10: (256, 256, 3)}
STRIDES, POOLED = {0: (4, 2), 3: (1, 2), 6: (1, 1), 8: (1, 1), 10: (1, 1)}, (3, 6)


@pytest.fixture
def weights(tmp_path):
    """A file with an untrained AlexNet."""
    random = torch.Generator().manual_seed(0)
    tensors = {}
    for index, (features, channels, side) in LAYERS.items():
        kernel = torch.randn(features, channels, side, side, generator=random)
        tensors[f"features.{index}.weight"] = kernel / math.sqrt(channels * side**2)
        tensors[f"features.{index}.bias"] = 0.1 * torch.randn(features, generator=random)
    torch.save(tensors, tmp_path / "alexnet.pth")
    return tmp_path / "alexnet.pth"


def twin(image, reference, weights):
    """Zhang et al. 2018, equation 1, of clipped sRGB in [0, 1]."""
    tensors = torch.load(weights, weights_only=True)
    heads = importlib.resources.files("lpips") / "weights" / "v0.1" / "alex.pth"
    linear = torch.load(heads, map_location="cpu", weights_only=True)
    shift = torch.tensor([-0.030, -0.088, -0.188]).view(1, 3, 1, 1)  # of the package: ImageNet
    scale = torch.tensor([0.458, 0.448, 0.450]).view(1, 3, 1, 1)
    pair = [(2 * x - 1 - shift) / scale for x in (image, reference)]
    distance = 0.0
    for number, index in enumerate(LAYERS):
        stride, padding = STRIDES[index]
        kernel, bias = (tensors[f"features.{index}.{name}"] for name in ("weight", "bias"))
        pair = [F.max_pool2d(x, 3, 2) if index in POOLED else x for x in pair]
        pair = [F.conv2d(x, kernel, bias, stride, padding).relu() for x in pair]
        unit = [x / x.square().sum(1, keepdim=True).sqrt().clamp_min(1e-10) for x in pair]
        head = linear[f"lin{number}.model.1.weight"]
        distance += (head * (unit[0] - unit[1]).square()).sum(1).mean().item()
    return distance


def test_the_distance_is_that_of_a_twin_and_equal_images_have_none(weights, monkeypatch):
    import_or_skip("lpips")
    monkeypatch.setattr(module, "_weights_file", lambda: weights)
    random = torch.Generator().manual_seed(1)
    reference, image = torch.rand(2, 1, 3, 40, 48, generator=random)
    comparison = LPIPS.compare(image, reference, reference)
    expected = twin(comparison.display_image, comparison.display_reference, weights)
    assert expected > 0.01
    assert LPIPS.score(comparison).item() == pytest.approx(expected, rel=1e-3)
    assert LPIPS.score(LPIPS.compare(reference, reference, reference)).item() == 0
    load_network.cache_clear()


def test_missing_and_other_weights_are_errors_that_say_where_to_get_them(
    weights, tmp_path, monkeypatch
):
    image = torch.rand(1, 3, 40, 40)
    comparison = LPIPS.compare(image, image, image)
    monkeypatch.setenv(module.WEIGHTS_VARIABLE, str(tmp_path / "none.pth"))
    with pytest.raises(LpipsWeightsError, match=r"none\.pth does not exist\. Download https://"):
        LPIPS.score(comparison)
    monkeypatch.setenv(module.WEIGHTS_VARIABLE, str(weights))
    with pytest.raises(LpipsWeightsError, match="SHA-256 begins with .*, not with 7be5be79"):
        LPIPS.score(comparison)


def test_an_image_that_is_too_small_for_alexnet_has_no_score():
    image = torch.rand(1, 3, 30, 40)
    assert LPIPS.score(LPIPS.compare(image, image, image)).isnan().all()
