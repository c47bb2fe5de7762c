"""The networks of `ours`: sizes, pace of the sampler, variants, and cards of shipped weights."""

from __future__ import annotations

import json
import math
from dataclasses import asdict

import pytest
import torch
from torch import nn
from torch.nn import functional as F

from methods.ours import FAMILY, VARIANTS
from methods.ours.method import CARDS
from methods.ours.networks import Encoder, Networks, Sampler
from rlbench.ops.init import kaiming_init
from rlbench.weights import read_card


def parameters(network: nn.Module) -> int:
    return sum(p.numel() for p in network.parameters())


@pytest.mark.parametrize(
    ("network", "count"),
    [
        (Networks(VARIANTS["paper"]).sampler, 31_101),
        (Networks(VARIANTS["paper"]).encoder, 54_816),
        (Networks(VARIANTS["paper"]).denoiser, 939_683),
        (Encoder(63, (64,), 32, 1), 6_176),  # 1x1 kernels, as in the release
        (Sampler(39, VARIANTS["latent-small"].sampler), 486 - 19),  # the release has two outputs
    ],
    ids=["sampler", "encoder", "denoiser", "small encoder", "small sampler"],
)
def test_parameter_counts_are_those_of_the_fact_sheet(network, count):
    assert parameters(network) == count


def test_a_paced_sampler_multiplies_its_action_by_a_power_of_the_budget():
    sampler = Sampler(4, (4, 8, 16), paced=True)
    kaiming_init(sampler, 0)
    sampler.last.weight.data.mul_(0.01)  # where tanh is nearly linear
    inputs = torch.randn(1, 4, 16, 16, generator=torch.Generator().manual_seed(0))
    inputs[:, -1] = math.log(3.0)
    with torch.no_grad():
        plain = sampler(inputs).atanh()
        sampler.pace.copy_(torch.tensor([math.log(0.5), -1.0]))
        torch.testing.assert_close(sampler(inputs).atanh(), plain / 6, rtol=1e-3, atol=1e-4)


def test_a_sampler_with_a_stride_acts_on_means_of_blocks():
    """On an input that is constant in each block, it acts as a sampler of the small image."""
    coarse, fine = (Sampler(4, (4, 8, 16), stride=stride) for stride in (1, 2))
    kaiming_init(coarse, 0)
    coarse.last.weight.data.mul_(0.01)  # where tanh is nearly linear
    fine.load_state_dict(coarse.state_dict())
    small = torch.randn(1, 4, 16, 16, generator=torch.Generator().manual_seed(0))
    with torch.no_grad():
        action = fine(F.interpolate(small, scale_factor=2, mode="nearest"))
        expected = F.interpolate(coarse(small).atanh(), scale_factor=2, mode="bilinear").tanh()
    torch.testing.assert_close(action, expected, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("name", [n for n, v in FAMILY.variants.items() if v.weights_from])
def test_a_variant_with_the_weights_of_another_has_its_networks(name):
    source = FAMILY.variants[name].weights_from.partition("/")[2]
    networks = {"latent", "encoder", "sampler", "denoiser", "accumulation", "history_mode"}
    one, other = asdict(VARIANTS[name]), asdict(VARIANTS[source])
    assert {field for field in one if one[field] != other[field]}.isdisjoint(networks)


def test_the_papers_recipe_reads_the_state_alone():
    """Channels as in the paper: 32 of the state, or the samples and G-buffer without an encoder."""
    recipes = {name: config for name, config in VARIANTS.items() if name.startswith("paper")}
    inputs = {
        name: Networks(config).denoiser.enc_conv0.in_channels for name, config in recipes.items()
    }
    assert inputs.pop("paper-B1") == inputs.pop("paper-B2") == 24 + 7
    assert set(inputs.values()) == {32}


@pytest.mark.parametrize("file", sorted(CARDS.glob("*.safetensors")), ids=lambda file: file.stem)
def test_a_shipped_card_records_the_config_of_its_variant(file):
    """Of the fields that there were when it was trained."""
    card = read_card(file)
    recorded = json.loads(card.method_config)
    config = json.loads(json.dumps(asdict(VARIANTS[card.name.partition("/")[2]].for_training)))
    assert recorded == {name: config[name] for name in recorded}
