"""OIDN: exposure, range, training; rows of other ideas that start from Intel's weights."""

from __future__ import annotations

from itertools import islice

import pytest
import torch
from torch import Tensor

from baselines.oidn.method import Oidn, published_network, to_radiance, widen
from baselines.oidn.train import _frame_loss, training_task
from rlbench import registry
from rlbench.clips.in_memory import InMemoryClip
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.errors import PluginError
from rlbench.frames import Frame, GBuffer, Reference, Size, StoredPool
from rlbench.ops.exposure import autoexposure
from rlbench.ops.transfer import pu_forward
from rlbench.ops.unet import UNet
from rlbench.run import run_clip
from tests.baselines.noise import read_samples

CPU = torch.device("cpu")


def clip(h: int = 21, w: int = 35, frames: int = 1, gain: float = 1.0, n: int = 1) -> InMemoryClip:
    """Noise around a smooth image of a tilted plane, with background on the left."""
    generator = torch.Generator().manual_seed(7)
    clip_frames = []
    for index in range(frames):
        reference = (torch.linspace(0, 6 + index, w).sin() + 1.5).expand(n, 3, h, w) * gain
        noise = torch.empty(n, 8, 3, h, w).exponential_(generator=generator)
        normal = torch.tensor([0.6, 0.0, -0.8]).view(1, 3, 1, 1).repeat(n, 1, h, w)
        normal[..., : w // 4] = 0
        gbuffer = GBuffer({"albedo": torch.full((n, 3, h, w), 0.5), "normal": normal})
        pool = StoredPool(reference[:, None] * noise, rounding_seeds=tuple(range(index, index + n)))
        clip_frames.append(Frame(index, gbuffer, pool, Reference(reference, reference)))
    return InMemoryClip("clip", "clip", "", clip_frames)


def test_output_out_of_range_gives_radiance_within_half_floats():
    image = to_radiance(torch.tensor([-1e4, 1e4]).expand(1, 3, 2, 2), torch.ones(1, 1, 1, 1))
    assert ((image >= 0) & (image <= 65504 * 1.001)).all()  # PU in float32


class IdentityNetwork(torch.nn.Module):
    """A network that returns its input colour and records its input."""

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        self.input = x
        return x[:, :3]


def test_an_identity_network_gives_the_mean_of_the_samples():
    """Exposure, transfer and padding are undone."""
    (frame,) = clip()
    (result,) = run_clip(Oidn(IdentityNetwork()), clip(), 8.0)
    mean = read_samples(frame).mean
    torch.testing.assert_close(result.image, mean, rtol=2e-4, atol=1e-6)  # PU in float32


def test_the_network_reads_exposed_colour_albedo_and_normals_in_zero_to_one():
    network = IdentityNetwork()
    (result,) = run_clip(Oidn(network), clip(32, 48), 8.0)
    colour, albedo, normal = network.input.split(3, dim=1)
    mean = result.samples.mean
    luminance = (mean * torch.tensor([0.212671, 0.71516, 0.072169]).view(3, 1, 1)).sum(1)
    tiles = luminance.unflatten(1, (-1, 16)).unflatten(3, (-1, 16)).mean((2, 4))
    exposure = 0.18 / tiles.log().mean().exp()
    torch.testing.assert_close(colour, pu_forward(mean * exposure), rtol=1e-5, atol=1e-6)
    assert torch.equal(albedo, torch.full_like(albedo, 0.5))
    assert (normal[..., :12] == 0.5).all()  # background
    torch.testing.assert_close(normal[0, :, 0, -1], torch.tensor([0.8, 0.5, 0.1]))


def training_loss(network: IdentityNetwork, gain: float) -> tuple[Tensor, Tensor]:
    """The loss where all samples are `gain` times the reference, and the reference."""
    (frame,) = clip(32, 32)
    reference = frame.reference.mean
    pool = StoredPool(gain * reference[:, None].expand(-1, 8, -1, -1, -1), (0,))
    noise_free = InMemoryClip("", "", "", [Frame(0, frame.gbuffer, pool, frame.reference)])
    return _frame_loss(Oidn(network), noise_free, 4.0), reference


def test_the_loss_of_a_perfect_output_is_zero():
    assert float(training_loss(IdentityNetwork(), 1.0)[0]) < 1e-5  # float32 moments


def test_exposure_in_training_comes_from_the_reference():
    network = IdentityNetwork()
    _, reference = training_loss(network, 0.1)
    expected = pu_forward(0.1 * reference * autoexposure(reference))
    torch.testing.assert_close(network.input[:, :3], expected)


def test_tuning_starts_from_intels_weights():
    pytest.importorskip("pyoidn", reason="the extra oidn is not installed")
    from baselines.oidn_intel.extract import load_network

    theirs, ours = load_network().state_dict(), training_task("tuned", CPU, 0).networks.state_dict()
    assert all(torch.equal(ours[name], theirs[name]) for name in theirs)
    assert training_task("tuned", CPU, 0).max_lr < training_task("retrained", CPU, 0).max_lr


@pytest.mark.parametrize("name", ["ntas/intel", "dasr/intel"])
def test_new_inputs_and_the_sampler_get_a_gradient(name):
    task = registry.training_task(name)
    before = {key: value.clone() for key, value in task.networks.state_dict().items()}
    optimizer = torch.optim.SGD(task.networks.parameters(), 1e-3)
    for loss in islice(task.losses(procedural_clip(3, Size(1, 48, 64), 2), 4.0), 2):
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


def test_without_weights_the_error_names_the_training():
    with pytest.raises(PluginError, match="rlbench train -m ntas/intel"):
        registry.load_method("ntas/intel")
