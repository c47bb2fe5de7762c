"""Shipped weights were trained fairly: on the same clips, none of which is scored."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from rlbench import registry
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.run import run_clip
from rlbench.weights import ModelCard, digest, read_card

ROOT = Path(__file__).parent.parent
SHIPPED = sorted(ROOT.glob("*/*/cards/*.safetensors"))
NAMES = [path.stem for path in SHIPPED]
SCORED_SCENES = ("city", "temple", "hall", "ripples")

shipped = pytest.mark.parametrize("path", SHIPPED, ids=NAMES)


def test_every_pretrained_method_has_shipped_weights():
    names = [
        n
        for family in registry.list_plugins("methods")
        for n in registry.load_family(family).method_names()
    ]
    learned = [
        name
        for name in names
        if registry.is_trainable(name) and registry.get_variant(name).pretrained
    ]
    assert {name.rpartition("/")[2] for name in learned} == set(NAMES)


def test_weights_shared_between_variants_exist():
    families = [registry.load_family(name) for name in registry.list_plugins("methods")]
    files = {
        f.weights_file(key)
        for f in families
        for key, row in f.variants.items()
        if row.learned and row.pretrained
    }
    assert files == {path.name for path in SHIPPED}


@shipped
def test_weights_match_their_card(path):
    card = read_card(path)
    assert card.sha256 == digest(path)
    assert card.name.rpartition("/")[2] == path.stem
    assert math.isfinite(card.seconds)
    assert card.command.startswith("rlbench train")


@shipped
def test_no_scored_scene_was_trained_on(path):
    trained = {clip.split()[0] for clip in read_card(path).data}
    assert trained
    assert not [name for name in trained for scored in SCORED_SCENES if scored in name]


@shipped
def test_every_learned_method_was_trained_on_the_same_frames(path):
    card, first = read_card(path), read_card(SHIPPED[0])
    assert (card.frames_seen, card.seed) == (first.frames_seen, first.seed)
    assert _clips(card) == _clips(first)
    if path.stem != "restir+oidn":  # trained on another pool
        assert card.data == first.data


@shipped
def test_a_card_states_when_training_started_from_intel_weights(path):
    family = path.parent.parent.name
    fine_tuned = path.stem in ("tuned", "restir+oidn")
    from_intel = (family == "ours" and path.stem != "paper") or fine_tuned
    assert read_card(path).origin.startswith("Intel's weights") == from_intel


ADAPTIVE = [
    name
    for family in registry.list_plugins("methods")
    for name in registry.load_family(family).method_names()
    if (row := registry.get_variant(name)).learned and row.pretrained and row.traits.adaptive
]


@pytest.mark.parametrize("name", ADAPTIVE)
def test_a_trained_sampling_map_has_not_collapsed(name):
    """A collapsed map is constant but for a few pixels: in one case 36859 of 36864 were equal."""
    for result in run_clip(registry.load_method(name), procedural_clip(frames=2), 4.0):
        counts = result.samples.counts
        assert float((counts == counts.median()).float().mean()) < 0.99


def _clips(card: ModelCard) -> list[str]:
    """Names of the clips on a card, without their hashes, which depend on the pool read too."""
    return [entry.split()[0] for entry in card.data]
