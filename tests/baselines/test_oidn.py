"""OIDN: network sizes of the original, equivariance to exposure, and training."""

from __future__ import annotations

import pytest
import torch

from baselines.oidn.method import Oidn, build, to_radiance
from baselines.oidn.train import _frame_loss, training_task
from rlbench.clips.in_memory import InMemoryClip
from rlbench.frames import Frame, GBuffer, Reference, Samples, StoredPool
from rlbench.ops.exposure import autoexposure
from rlbench.ops.transfer import pu_forward
from rlbench.run import run_clip

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


@pytest.mark.parametrize("gain", [2.0**-5, 3.0, 2.0**7])
def test_the_image_scales_with_the_radiance(gain):
    method = build("", CPU, "random")
    (plain,) = run_clip(method, clip(), 2.0)
    (scaled,) = run_clip(method, clip(gain=gain), 2.0)
    assert plain.image.max() > plain.image.min()
    # exposure in float32, then a logarithm and an exponential with 16 nats between 0 and 1
    torch.testing.assert_close(scaled.image / gain, plain.image, rtol=2e-3, atol=1e-5)


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), -1.0, 0.0])
def test_invalid_radiance_gives_a_finite_image(bad):
    (frame,) = clip()
    samples = Samples(torch.full((1, 8, 3, 21, 35), bad), torch.full((1, 1, 21, 35), 8))
    image, _ = build("", CPU, "random").denoise(frame.gbuffer, samples, None)
    assert torch.isfinite(image).all()


def test_output_out_of_range_gives_radiance_within_half_floats():
    image = to_radiance(torch.tensor([-1e4, 1e4]).expand(1, 3, 2, 2), torch.ones(1, 1, 1, 1))
    assert ((image >= 0) & (image <= 65504 * 1.001)).all()  # PU in float32


def test_negative_radiance_counts_as_zero():
    (frame,) = clip()
    counts = torch.full((1, 1, 21, 35), 8)
    radiance = frame.pool.read(frame.pool.empty(), counts)
    radiance[..., :5] = 0
    lower = radiance.clone()
    lower[..., :5] = -1
    method = build("", CPU, "random")
    expected, _ = method.denoise(frame.gbuffer, Samples(radiance, counts), None)
    image, _ = method.denoise(frame.gbuffer, Samples(lower, counts), None)
    assert torch.equal(image, expected)


class IdentityNetwork(torch.nn.Module):
    """A network that returns its input colour and records its input."""

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        self.input = x
        return x[:, :3]


def test_an_identity_network_gives_the_mean_of_the_samples():
    """Exposure, transfer and padding are undone."""
    (frame,) = clip()
    (result,) = run_clip(Oidn(IdentityNetwork()), clip(), 8.0)
    mean = frame.pool.read(frame.pool.empty(), torch.full((1, 1, 21, 35), 8)).mean(1)
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


def test_the_loss_of_a_perfect_output_is_zero():
    """A noise-free pool, an identity network, and the exposure of the reference."""
    (frame,) = clip(32, 32)
    pool = StoredPool(frame.reference.mean[:, None].expand(-1, 8, -1, -1, -1), (0,))
    noise_free = InMemoryClip("", "", "", [Frame(0, frame.gbuffer, pool, frame.reference)])
    assert float(_frame_loss(Oidn(IdentityNetwork()), noise_free, 4.0)) < 1e-5  # float32 moments


def test_exposure_in_training_comes_from_the_reference():
    (frame,) = clip(32, 32)
    reference, network = frame.reference.mean, IdentityNetwork()
    dark = StoredPool(0.1 * reference[:, None].expand(-1, 8, -1, -1, -1), (0,))
    _frame_loss(
        Oidn(network),
        InMemoryClip("", "", "", [Frame(0, frame.gbuffer, dark, frame.reference)]),
        4.0,
    )
    expected = pu_forward(0.1 * reference * autoexposure(reference))
    torch.testing.assert_close(network.input[:, :3], expected)


def test_tuning_starts_from_intels_weights():
    pytest.importorskip("pyoidn", reason="the extra oidn is not installed")
    from baselines.oidn_intel.extract import load_network

    theirs, ours = load_network().state_dict(), training_task("tuned", CPU, 0).networks.state_dict()
    assert all(torch.equal(ours[name], theirs[name]) for name in theirs)
    assert training_task("tuned", CPU, 0).max_lr < training_task("retrained", CPU, 0).max_lr
