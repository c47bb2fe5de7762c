"""A latent that the denoiser writes: what the next frame reads, and what gradients reach."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from torch.nn import functional as F

from methods.ours.initialization import initialize
from methods.ours.method import Ours
from methods.ours.train import config_task
from research.fit_one_clip import fit
from research.lean_search import CONFIGS, FAMILY, build
from rlbench import registry
from rlbench.benchmark.speed import count_work
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import Size
from rlbench.run import run_clip, unroll
from tests.procedural_folder import write_world

CPU = torch.device("cpu")
CLIP = procedural_clip(size=Size(1, 48, 48), frames=3, static=True)


def initial(name: str) -> Ours:
    """The networks of a configuration before their first step of training."""
    method = build(name, CPU, "random")
    initialize(method.networks, method.config, seed=0)
    return method


def test_the_latent_is_the_output_of_the_denoiser_and_the_input_of_the_next_frame() -> None:
    method = initial("bptt-3")
    frames = list(CLIP)
    state = method.start(CLIP.size)
    result = next(run_clip(method, CLIP, 1.0))
    _, state = method.denoise(frames[0].gbuffer, result.samples, state)
    assert state.features.shape == (1, 8, 48, 48)
    assert state.features.std() > 1e-3
    history = method.reproject(frames[1].gbuffer, state)
    torch.testing.assert_close(history.features, state.features)  # nothing moves


@pytest.mark.parametrize(("name", "crosses"), [("bptt-3", True), ("bptt-1", False)])
def test_gradients_and_a_loss_cross_as_many_frames_as_configured(name: str, crosses: bool) -> None:
    task = config_task(CONFIGS[name], FAMILY.variants[name].traits, CPU, seed=0)
    assert len(list(task.losses(CLIP, 1.0))) == (1 if crosses else 3)
    method = task.method
    torch.nn.init.normal_(method.networks.denoiser.enc_conv0.weight, std=0.1)  # reads the latent
    written = method.networks.denoiser.dec_conv0.weight
    results = list(unroll(method, CLIP, 1.0))
    (gradient,) = torch.autograd.grad(results[2].image.mean(), written)
    # the rows of the latent change an image through the next frame only
    assert bool((gradient[4:] != 0).any()) == crosses


def test_ours_with_a_latent_costs_less_than_112_thousand_multiply_adds_per_pixel() -> None:
    methods = initial("latent-0"), initial("latent-8"), registry.load_method("ours")
    without, with_latent, ours = (count_work(method, CPU).multiply_adds for method in methods)
    assert without < with_latent < 112e3
    assert ours < 112e3


def test_filtered_radiance_replaces_the_colour_where_the_gate_is_open() -> None:
    method = initial("kernel-3")
    last = method.networks.denoiser.dec_conv0
    last.weight[4:].zero_()
    last.bias[4:].zero_()  # equal weights: a box filter
    last.bias[3] = -80.0  # no previous image
    last.bias[4 + 4] = 80.0  # after colour, blend and 4 channels of latent
    frame = CLIP.frames[0]
    samples = next(run_clip(method, CLIP, 1.0)).samples
    image, state = method.denoise(frame.gbuffer, samples, method.start(CLIP.size))
    padded = F.pad(state.radiance.mean, (1, 1, 1, 1), mode="replicate")
    # a box filter, through the log transfer and back
    torch.testing.assert_close(image, F.avg_pool2d(padded, 3, 1), rtol=1e-4, atol=1e-5)


def test_one_clip_is_scored_before_and_after_it_is_trained_on(tmp_path: Path) -> None:
    folder = write_world(tmp_path / "world")
    (start, before), *_, (end, after) = fit(folder, "latent-0", frames=12, max_lr=1e-4, crop=48)
    assert (start, end) == (0, 12)
    assert len(before) == len(after) == 2
    assert after != before


def test_ours_may_start_from_the_denoiser_of_oidn_tuned() -> None:
    """Its first image is that of `accumulate/contrast`, which has that denoiser."""
    expected, image = (
        next(run_clip(method, CLIP, 2.0)).image
        for method in (registry.load_method("accumulate/contrast"), initial("tuned"))
    )
    # the same sums, with six input channels of zero weight more
    torch.testing.assert_close(image, expected, rtol=1e-3, atol=1e-5)
