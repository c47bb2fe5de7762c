"""The table of variants: changed fields, names, aliases, and cards of shipped weights."""

from __future__ import annotations

import json
from dataclasses import asdict

import pytest

from methods.ours import FAMILY
from methods.ours.method import CARDS
from methods.ours.networks import Networks
from methods.ours.variants import BASE, SLOTS, VARIANTS
from rlbench import registry
from rlbench.weights import read_card


@pytest.mark.parametrize(
    ("variant", "fields"),
    [
        ("", set()),
        (
            "paper",
            {"accumulation", "density", "log_loss", "learner", "gamma", "wired_contrast"},
        ),
        ("A1", {"learner"}),
        ("A2", {"sampler"}),
        ("B1", {"encoder", "history_mode", "accumulation"}),
        ("B2", {"encoder", "history_mode", "accumulation"}),
        ("C", {"sample_encoding"}),
        ("reinforce", {"learner"}),
        ("C+count", {"sample_encoding"}),
        ("small", {"sampler", "encoder_kernel", "denoiser"}),
        ("flat", {"ignore_density"}),
        ("lag", {"antilag"}),
        ("sampler-small", {"sampler"}),
        ("sampler-large", {"sampler"}),
        ("encoder-small", {"encoder_kernel"}),
        ("encoder-large", {"encoder"}),
        ("denoiser-small", {"denoiser"}),
        ("denoiser-large", {"denoiser"}),
    ],
)
def test_a_variant_changes_only_what_its_row_claims(variant, fields):
    base, other = asdict(BASE), asdict(VARIANTS[variant])
    assert {name for name in base if base[name] != other[name]} == fields


@pytest.mark.parametrize(
    ("variant", "fields"),
    [
        ("appo", {"learner"}),
        ("A1", {"learner", "gamma"}),
        ("A2", {"sampler"}),
        ("B1", {"encoder", "history_mode"}),
        ("B2", {"encoder", "history_mode", "gamma"}),
        ("C", {"sample_encoding"}),
    ],
)
def test_an_ablation_of_the_papers_recipe_changes_only_what_its_row_claims(variant, fields):
    base, other = asdict(VARIANTS["paper"]), asdict(VARIANTS[f"paper-{variant}"])
    assert {name for name in base if base[name] != other[name]} == fields


@pytest.mark.parametrize("variant", ["A1", "A2", "B1", "B2", "C"])
def test_an_ablation_has_the_traits_of_its_namesake(variant):
    """Budgets, inputs and least samples do not depend on the recipe."""
    assert FAMILY.variants[f"paper-{variant}"].traits == FAMILY.variants[variant].traits


def test_the_papers_recipe_reads_the_state_alone():
    """Channels as in the paper: 32 of the state, or the samples and G-buffer without an encoder."""
    recipes = {name: config for name, config in VARIANTS.items() if name.startswith("paper")}
    inputs = {
        name: Networks(config).denoiser.enc_conv0.in_channels for name, config in recipes.items()
    }
    assert inputs.pop("paper-B1") == inputs.pop("paper-B2") == 24 + 7
    assert set(inputs.values()) == {32}


def test_the_table_and_the_family_name_the_same_variants():
    assert list(VARIANTS) == list(FAMILY.variants)


@pytest.mark.parametrize("variant", VARIANTS)
def test_no_more_samples_are_drawn_than_the_encoder_reads(variant):
    assert FAMILY.variants[variant].traits.max_samples == SLOTS


def test_the_former_name_of_reinforce_is_an_alias():
    assert registry.expand(["ours/ppo", "ours/reinforce"]) == ["ours/reinforce"]
    assert "ours/ppo" not in FAMILY.method_names()
    assert registry.get_variant("ours/ppo") is FAMILY.variants["reinforce"]
    method = registry.load_method("ours/ppo", weights="random")
    assert method.config == VARIANTS["reinforce"]


FORMER_FIELDS = {
    "samples": "sample_encoding",
    "remembers": "history_mode",
    "light": "accumulation",
    "kernel": "encoder_kernel",
    "decibels": "log_loss",
    "flat": "ignore_density",
}


FORMER_VALUES = {
    "gathered": "temporal",
    "ppo-pixel": "reinforce",
    "ppo-pixel+surrogate": "reinforce+surrogate",
}


@pytest.mark.parametrize("file", sorted(CARDS.glob("*.safetensors")), ids=lambda file: file.stem)
def test_a_shipped_card_records_the_config_of_its_variant(file):
    """Cards written before hold former names of fields and values."""
    card = read_card(file)
    recorded = {
        FORMER_FIELDS.get(name, name): FORMER_VALUES.get(value, value)
        if isinstance(value, str)
        else value
        for name, value in json.loads(card.method_config).items()
    }
    config = json.loads(json.dumps(asdict(VARIANTS[card.name.partition("/")[2]].for_training)))
    assert recorded == {name: config[name] for name in recorded}
