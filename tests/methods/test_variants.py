"""The table of variants, and the cards of shipped weights."""

from __future__ import annotations

import json
from dataclasses import asdict

import pytest

from methods.ours import FAMILY, VARIANTS
from methods.ours.method import CARDS
from methods.ours.networks import Networks
from rlbench.weights import read_card


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
