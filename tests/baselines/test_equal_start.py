"""Rows that start from Intel's weights: their first image is that of `oidn`; all learn."""

from __future__ import annotations

from itertools import islice

import pytest
import torch
from torch import Tensor

from baselines.oidn.equal_start import EqualStart
from baselines.oidn.method import published_network, widen
from rlbench import registry
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.errors import PluginError
from rlbench.frames import Size
from rlbench.ops.unet import UNet
from rlbench.run import FrameResult, run_clip

ROWS = ("ntas/intel", "dasr/intel")
CLIP = procedural_clip(3, Size(1, 48, 64), frames=2)


def images(method: object, spp: float) -> list[FrameResult]:
    return list(run_clip(method, CLIP, spp))


def untrained(name: str) -> EqualStart:
    task = registry.training_task(name)
    return EqualStart(task.networks.requires_grad_(False), registry.get_variant(name).traits)


@pytest.mark.parametrize("name", ROWS)
@pytest.mark.parametrize("spp", [1.0, 4.0])
def test_the_first_image_is_that_of_oidn(name, spp):
    (result, _), (expected, _) = (
        images(method, spp) for method in (untrained(name), registry.load_method("oidn"))
    )
    torch.testing.assert_close(result.image, expected.image, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("name", ROWS)
def test_new_inputs_and_the_sampler_get_a_gradient(name):
    task = registry.training_task(name)
    before = {key: value.clone() for key, value in task.networks.state_dict().items()}
    optimizer = torch.optim.SGD(task.networks.parameters(), 1e-3)
    for loss in islice(task.losses(CLIP, 4.0), 2):
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()

    def moved(key: str, new: slice) -> Tensor:
        return (task.networks.state_dict()[key] - before[key])[:, new].abs().sum()

    assert moved("sampler.dec_conv0.weight", slice(None)) > 0
    if name == "ntas/intel":
        assert moved("denoiser.enc_conv0.weight", slice(9, None)) > 0


def test_a_wider_network_computes_what_its_source_does_whatever_its_new_inputs():
    source, wide = published_network()[0], UNet(12, 5, seed=1)
    fresh = wide.dec_conv0.weight[3:].clone()
    widen(wide, source)
    features, more = torch.rand(1, 9, 32, 32), torch.rand(1, 3, 32, 32)
    with torch.no_grad():
        output = wide(torch.cat((features, more), 1))
        torch.testing.assert_close(output[:, :3], source(features), rtol=1e-4, atol=1e-5)
    assert torch.equal(wide.dec_conv0.weight[3:], fresh)


@pytest.mark.parametrize("name", ROWS)
def test_without_weights_the_error_names_the_training(name):
    with pytest.raises(PluginError, match=f"rlbench train -m {name}"):
        registry.load_method(name)
