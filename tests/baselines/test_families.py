"""All families: metadata without torch; those that learn: sizes, gradients, and training."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor

from rlbench import registry
from rlbench.clips.in_memory import InMemoryClip
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import Samples, Size
from rlbench.training.task import TrainingTask
from tests.baselines.noise import random_tensor, read_samples

FAMILIES = registry.list_plugins("methods")
PARAMETERS = {  # by hand from the layers; published ones where the fact sheet has them
    "dasr": {"sampler": 1_069_477, "denoiser": 1_070_631},
    "imcd": {"unet": 938_944, "encoder": 2_464},
    "nppd": {"unet": 1_793_277, "encoder": 2_464},
    "nppd/large": {"unet": 15_590_877},  # its authors call it "15M"
    "ntas": {"sampler": 920_097, "denoiser": 947_114},
    "ntas/direct": {"denoiser": 920_675 + 3 * (32 + 64) * 9},
    "oidn/retrained": {"": 919_811},
}
RECURRENT = ("imcd", "nppd", "ntas", "ntas/intel")
SIZE = Size(1, 32, 32)
TRAINED = (
    "dasr",
    "dasr/intel",
    "imcd",
    "nppd",
    "ntas",
    "ntas/direct",
    "ntas/intel",
    "oidn/retrained",
)


def task_of(name: str, seed: int = 0) -> TrainingTask:
    return registry.training_task(name, torch.device("cpu"), seed)


def clip(frames: int = 2, n: int = 1, side: int = 32) -> InMemoryClip:
    return procedural_clip(3, Size(n, side, side), frames)


@pytest.mark.parametrize("name", FAMILIES)
def test_every_variant_of_a_family_has_a_config(name: str) -> None:
    module = importlib.import_module(registry.load_family(name).build.partition(":")[0])
    declared = set(registry.load_family(name).variants) - {"intel"}  # a class of its own
    assert set(getattr(module, "VARIANTS", declared)) - {"intel"} == declared


@pytest.mark.parametrize("name", PARAMETERS)
def test_networks_have_the_published_number_of_parameters(name: str) -> None:
    networks = task_of(name).networks
    counts = {
        part: sum(p.numel() for p in networks.get_submodule(part).parameters())
        for part in PARAMETERS[name]
    }
    assert counts == PARAMETERS[name]


@pytest.mark.parametrize("name", TRAINED)
@pytest.mark.parametrize("bad", [torch.nan, torch.inf, -1.0])
def test_an_invalid_sample_leaves_the_image_finite(name: str, bad: float) -> None:
    (frame,) = clip(1)
    radiance = frame.pool.radiance.clone()
    radiance[:, 2, :, 3, 3] = bad
    method = registry.load_method(name, weights="random")
    samples = Samples(radiance, torch.full((1, 1, 32, 32), 8))
    image, _ = method.denoise(frame.gbuffer, samples, method.start(SIZE))
    assert torch.isfinite(image).all()
    assert (image >= 0).all()


@pytest.mark.parametrize("name", TRAINED)
def test_the_order_of_samples_has_no_effect(name: str) -> None:
    frame, method = clip(1).frames[0], registry.load_method(name, weights="random")
    samples = read_samples(frame)
    shuffled = replace(samples, radiance=samples.radiance[:, [3, 1, 7, 0, 2, 6, 5, 4]])
    first, second = (
        method.denoise(frame.gbuffer, each, method.start(SIZE))[0] for each in (samples, shuffled)
    )
    torch.testing.assert_close(first, second, rtol=1e-4, atol=1e-5)  # sums in another order


def edit_tensors(state: tuple[Any, ...], edit: Callable[[Tensor], Tensor]) -> Any:
    """A state, which is a named tuple, with its tensors changed."""
    return type(state)(*(edit(part) if isinstance(part, Tensor) else part for part in state))


@pytest.mark.parametrize("name", RECURRENT)
def test_the_first_frame_ignores_the_state(name: str) -> None:
    frame, method = clip(1).frames[0], registry.load_method(name, weights="random")
    start = method.start(SIZE)
    noise = edit_tensors(start, lambda part: random_tensor(*part.shape))
    first, second = (
        method.denoise(frame.gbuffer, read_samples(frame), state)[0] for state in (start, noise)
    )
    assert torch.equal(first, second)


@pytest.mark.parametrize("name", RECURRENT)
@pytest.mark.parametrize("bad", [torch.nan, torch.inf])
def test_a_nonfinite_state_is_invalid_history(name: str, bad: float) -> None:
    def damage(part: Tensor) -> Tensor:
        part = part.clone()
        part[..., 3, 3] = bad
        return part

    frame, method = clip(1).frames[0], registry.load_method(name, weights="random")
    still, samples = replace(frame.gbuffer, static=True), read_samples(frame)
    _, state = method.denoise(still, samples, method.start(SIZE))
    image, after = method.denoise(still, samples, edit_tensors(state, damage))
    assert torch.isfinite(image).all()
    assert all(torch.isfinite(part).all() for part in after if isinstance(part, Tensor))


@pytest.mark.parametrize("name", [name for name in TRAINED if "intel" not in name])
def test_the_seed_determines_the_weights(name: str) -> None:
    first, again, other = (dict(task_of(name, s).networks.named_parameters()) for s in (1, 1, 2))
    assert all(torch.equal(weight, again[key]) for key, weight in first.items())
    assert any(not torch.equal(weight, other[key]) for key, weight in first.items())


@pytest.mark.parametrize("name", TRAINED)
def test_two_frames_give_every_parameter_a_gradient(name: str) -> None:
    task = task_of(name)
    task.on_progress(0.99)
    for weight in task.networks.parameters():  # also where a first weight of zero cuts others off
        weight.data.add_(
            1e-3 * torch.randn(weight.shape, generator=torch.Generator().manual_seed(0))
        )
    for loss in task.losses(clip(n=2, side=64), 2.0):
        loss.backward()
    without = [k for k, p in task.networks.named_parameters() if p.grad is None or not p.grad.any()]
    assert without == []


@pytest.mark.parametrize(
    ("name", "frames", "count"),
    [
        *(("imcd", frames, count) for frames, count in ((1, 1), (2, 1), (5, 3))),
        *(("ntas", frames, count) for frames, count in ((1, 1), (2, 1), (5, 3))),
        *((name, 3, 3) for name in ("dasr", "nppd", "oidn/retrained")),
    ],
)
def test_losses_are_independent_and_as_many_as_the_unrolls(
    name: str, frames: int, count: int
) -> None:
    yielded = 0
    for loss in task_of(name).losses(clip(frames), 2.0):
        loss.backward()  # a graph shared with the previous loss would raise here
        yielded += 1
    assert yielded == count


@pytest.mark.parametrize(
    "name", ["dasr", "imcd", "nppd", "ntas", "oidn/retrained", "accumulate/tuned"]
)
def test_a_few_training_steps_lower_the_loss(name: str) -> None:
    task = task_of(name)
    task.on_progress(0.0)
    optimizer = torch.optim.Adam(task.networks.parameters(), min(1e-3, task.max_lr))
    totals = []
    for _ in range(10):
        total = 0.0
        for loss in task.losses(clip(), 2.0):
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            total += loss.item()
        totals.append(total)
    assert totals[-1] < totals[0] - 0.1 * abs(totals[0])
