"""The table of variants: changed fields, names, aliases, and cards of shipped weights."""

from __future__ import annotations

import json
from dataclasses import asdict, replace

import pytest

from methods.ours import FAMILY
from methods.ours.method import CARDS
from methods.ours.networks import Networks
from methods.ours.variants import SLOTS, VARIANTS, Config
from rlbench.weights import read_card


def changed_fields(variant: str, base: str) -> set[str]:
    """The settings that differ between two variants."""
    one, other = asdict(VARIANTS[variant]), asdict(VARIANTS[base])
    return {name for name in one if one[name] != other[name]}


@pytest.mark.parametrize(
    ("variant", "changes"),
    [
        ("A1", {"learner": "surrogate"}),
        ("A2", {"sampler": (), "contrast_density": False}),
        ("by-rule", {"ignore_density": True}),
        ("flat", {"ignore_density": True, "contrast_density": False}),
        ("lag", {"antilag": False}),
    ],
)
def test_a_variant_of_ours_changes_only_what_its_row_claims(variant, changes):
    assert changed_fields(variant, "") == set(changes)
    assert VARIANTS[variant] == replace(VARIANTS[""], **changes)


def test_ours_has_neither_encoder_nor_latent_and_accumulates_by_rule():
    config = VARIANTS[""]
    assert (config.encoder, config.latent, config.accumulation) == ((), 0, "rule")
    assert (config.sampler_stride, config.contrast_density) == (2, True)
    assert changed_fields("", "latent") == {
        *("encoder", "latent", "accumulation", "sampler_stride", "contrast_density"),
        "sample_encoding",  # for no encoder reads samples
    }


@pytest.mark.parametrize(
    ("variant", "fields"),
    [
        (
            "paper",
            {"accumulation", "density", "log_loss", "learner", "gamma", "wired_contrast"},
        ),
        ("latent-A1", {"learner"}),
        ("latent-A2", {"sampler"}),
        ("latent-B1", {"encoder", "history_mode", "accumulation"}),
        ("latent-B2", {"encoder", "history_mode", "accumulation"}),
        ("latent-C", {"sample_encoding"}),
        ("latent-reinforce", {"learner"}),
        ("latent-stochastic", {"learner"}),
        ("latent-C+count", {"sample_encoding"}),
        ("latent-small", {"sampler", "encoder_kernel", "denoiser"}),
        ("latent-initial", {"sampler"}),
        ("latent-by-rule", {"ignore_density", "contrast_density"}),
        ("latent-stateless", {"latent"}),
        ("latent-flat", {"ignore_density"}),
        ("latent-lag", {"antilag"}),
        ("latent-sampler-small", {"sampler"}),
        ("latent-sampler-large", {"sampler"}),
        ("latent-encoder-small", {"encoder_kernel"}),
        ("latent-encoder-large", {"encoder"}),
        ("latent-denoiser-small", {"denoiser"}),
        ("latent-denoiser-large", {"denoiser"}),
    ],
)
def test_a_variant_of_the_latent_state_changes_only_what_its_row_claims(variant, fields):
    assert changed_fields(variant, "latent") == fields


def test_latent_has_the_default_settings():
    assert VARIANTS["latent"] == Config()


@pytest.mark.parametrize(
    ("variants", "weights"),
    [
        (("by-rule", "flat", "lag"), "ours"),
        (("latent-by-rule", "latent-flat", "latent-lag"), "ours/latent"),
        (("", "A1", "A2", "latent", "latent-A1", "latent-A2", "paper"), None),
    ],
)
def test_variants_that_are_not_trained_have_the_weights_of_the_row_that_they_change(
    variants, weights
):
    assert {FAMILY.variants[variant].weights_from for variant in variants} == {weights}


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
    assert changed_fields(f"paper-{variant}", "paper") == fields


@pytest.mark.parametrize("variant", ["A1", "A2", "B1", "B2", "C"])
def test_an_ablation_has_the_traits_of_its_namesakes(variant):
    """Budgets, inputs and least samples do not depend on the recipe."""
    names = [f"{part}{variant}" for part in ("paper-", "latent-", "")]
    traits = [FAMILY.variants[name].traits for name in names if name in FAMILY.variants]
    assert len(traits) == (3 if variant in ("A1", "A2") else 2)
    assert traits == traits[:1] * len(traits)


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
