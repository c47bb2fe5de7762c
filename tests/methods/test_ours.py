"""The proposed method: its sizes, its variants, its gradients, and the policy that trains it."""

from __future__ import annotations

from dataclasses import asdict, replace

import pytest
import torch
from torch import Tensor, nn

from methods.ours import FAMILY
from methods.ours.method import Ours, build
from methods.ours.network import Encoder, Networks, Sampler
from methods.ours.train import trainer
from methods.ours.variants import BASE, VARIANTS
from rlbench.frames import Size
from rlbench.ops.initialise import initialise
from rlbench.procedural import procedural

CPU = torch.device("cpu")


def parameters(network: nn.Module) -> int:
    return sum(p.numel() for p in network.parameters())


@pytest.mark.parametrize(
    ("network", "count"),
    [
        (Sampler(39, BASE.sampler), 31_101),
        (Encoder(63, 32), 54_816),
        (Networks(BASE).denoiser, 939_683),
    ],
    ids=["sampler", "encoder", "denoiser"],
)
def test_parameter_counts_are_those_of_the_fact_sheet(network, count):
    assert parameters(network) == count


@pytest.mark.parametrize(("variant", "fields"), [("A2", {"sampler"}), ("flat", {"flat"})])
def test_a_variant_changes_only_what_its_row_claims(variant, fields):
    base, other = asdict(BASE), asdict(VARIANTS[variant])
    assert {name for name in base if base[name] != other[name]} == fields


@pytest.mark.parametrize("variant", VARIANTS)
def test_no_more_samples_are_bought_than_the_encoder_sees(variant):
    assert FAMILY.variants[variant].traits.cap == VARIANTS[variant].slots


def test_an_untrained_sampler_is_uniform():
    method = trainer("", CPU, seed=0).method
    clip = procedural(seed=1, size=Size(1, 32, 48), frames=1)
    frame = next(iter(clip))
    wish = method.plan(frame.view, frame.pool.empty(), method.start(clip.size))
    assert wish.unique().numel() == 1


def test_the_samplers_last_layer_is_shown_where_the_last_frames_samples_were_noisy():
    method = trainer("", CPU, seed=0).method
    shown: list[Tensor] = []
    method.networks.sampler.head.register_forward_hook(lambda layer, x, out: shown.append(out))
    clip = procedural(seed=1, size=Size(1, 64, 64), frames=1)
    frame = next(iter(clip))
    state = method.start(clip.size)
    noise = torch.rand(1, 1, 64, 32, generator=torch.Generator().manual_seed(0))
    state.latent[:] = 0.1
    state.latent[:, :3, :, 32:] += 0.2 * (noise - 0.5)
    with torch.no_grad():
        method.act(replace(frame.view, static=True), state)
    contrast = shown[0][0, 0]
    assert contrast[8:-8, 40:-8].mean() > contrast[8:-8, 8:24].mean() + 0.2


def test_every_network_gets_a_gradient_from_one_sequence():
    made = trainer("", CPU, seed=0)
    initialise(made.networks, 0)
    clip = procedural(seed=1, size=Size(2, 32, 32), frames=2)
    for loss in made.losses(clip, 2.0):
        loss.backward()
    without = [k for k, p in made.networks.named_parameters() if p.grad is None or not p.grad.any()]
    # biases of dead units may be untouched, but no whole layer may be
    assert not [name for name in without if name.endswith("weight")]


def test_the_state_carries_no_gradient_between_frames_at_bptt_one():
    made = trainer("", CPU, seed=0)
    clip = procedural(seed=1, size=Size(1, 32, 32), frames=1)
    frame = next(iter(clip))
    method = made.method
    assert isinstance(method, Ours)
    _, memory = method.denoise(frame.view, frame.pool.empty(), method.start(clip.size))
    assert memory.latent.requires_grad
    memory.latent.retain_grad()
    image, _ = method.denoise(frame.view, frame.pool.empty(), memory)
    image.sum().backward()
    assert memory.latent.grad is None


def test_the_first_frame_has_no_state():
    memory = build("", CPU, "random").start(Size(1, 8, 9))
    assert (memory.latent == -1).all()
