"""DASR: its pilot, losses and training stages."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy import ndimage
from torch import nn

from baselines.dasr.method import Dasr, build
from baselines.dasr.train import (
    laplacian_of_gaussian,
    relative_loss,
    training_task,
)
from rlbench.clips.in_memory import InMemoryClip
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import Size
from rlbench.run import run_clip
from tests.baselines.noise import one_sample, random_tensor

CPU = torch.device("cpu")
SIZE = Size(1, 24, 40)
DENOISER_STAGE = 0.1  # fraction of a training
DRAWS = 400_000


def small_clip(frames: int = 1) -> InMemoryClip:
    return procedural_clip(0, SIZE, frames)


@pytest.fixture(scope="module")
def method() -> Dasr:
    return build("", CPU, "random")


def test_the_pilot_is_part_of_the_mean_and_of_the_budget(method: Dasr) -> None:
    (frame,) = small_clip()
    (result,) = run_clip(method, small_clip(), 2.5)
    assert torch.equal(result.samples.radiance[:, 0], frame.pool.radiance[:, 0])
    assert int(result.samples.counts.sum()) == round(2.5 * SIZE.h * SIZE.w)


def test_the_density_depends_on_the_pilot(method: Dasr) -> None:
    (frame,) = small_clip()
    pilots = [one_sample(gain * frame.pool.radiance[:, 0]) for gain in (1.0, 2.0)]
    assert not torch.equal(*(method.plan(frame.gbuffer, pilot, None) for pilot in pilots))


def test_edges_equal_scipy() -> None:
    image = random_tensor(2, 3, 20, 27).double()
    options = {"mode": "constant", "radius": 5}
    planes = [
        ndimage.gaussian_laplace(ndimage.gaussian_filter(plane, 1.5, **options), 1.5, **options)
        for plane in image.flatten(0, 1).numpy()
    ]
    expected = torch.from_numpy(np.stack(planes)).view_as(image)
    # two sums of 22 terms in double precision
    torch.testing.assert_close(laplacian_of_gaussian(image), expected, rtol=0, atol=1e-12)


def test_the_loss_is_the_relative_error_of_colour_and_of_edges() -> None:
    image, reference = random_tensor(1, 3, 24, 24), random_tensor(1, 3, 24, 24, seed=1)
    colour, edges = ((f(image) - f(reference)).abs() for f in (torch.abs, laplacian_of_gaussian))
    expected = ((colour + edges) / (reference + 0.01)).mean()
    torch.testing.assert_close(relative_loss(image, reference), expected)


def updated_networks(variant: str, fraction_done: float) -> set[str]:
    """The networks that one training step changes at this point of the training."""
    task = training_task(variant, CPU, seed=0)
    nn.init.normal_(task.networks.sampler.last.weight, 0, 0.1, torch.Generator().manual_seed(0))
    before = {name: p.clone() for name, p in task.networks.named_parameters()}
    optimizer = torch.optim.Adam(task.networks.parameters(), 1e-3)
    task.on_progress(fraction_done)
    (loss,) = task.losses(small_clip(), 2.5)
    loss.backward()
    optimizer.step()
    after = task.networks.named_parameters()
    return {name.partition(".")[0] for name, p in after if not torch.equal(p, before[name])}


@pytest.mark.parametrize(
    ("variant", "fraction_done", "names"),
    [
        ("", 24.9 / 70, {"denoiser"}),
        ("", 25.1 / 70, {"sampler"}),
        ("", 29.9 / 70, {"sampler"}),
        ("", 30.1 / 70, {"denoiser", "sampler"}),
        ("", 0.0, {"denoiser"}),
        ("", 0.999, {"denoiser", "sampler"}),
    ],
)
def test_a_stage_updates_only_its_networks(
    variant: str, fraction_done: float, names: set[str]
) -> None:
    assert updated_networks(variant, fraction_done) == names


def test_sampling_is_uniform_before_the_sampler_is_trained() -> None:
    task = training_task("", CPU, seed=0)
    (result,) = run_clip(task.method, small_clip(), 3.0)
    assert torch.equal(result.samples.counts, torch.full_like(result.samples.counts, 3))
