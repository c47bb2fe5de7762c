"""Weights are loaded exactly as they were saved, or refused."""

from __future__ import annotations

import hashlib
import tomllib
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path

import pytest
import safetensors.torch
import torch
from torch import nn

from rlbench.weights import (
    ModelCard,
    WeightsError,
    card_path,
    digest,
    load_for_inference,
    load_into,
    read_card,
    save,
    training_clips,
)

CARD = ModelCard(
    name="oidn",
    data=("clip one", 'clip "two"\\\n\x7f é'),
    frames_seen=1200,
    steps=400,
    seconds=12.5,
    device="a CPU",
    seed=3,
    command="rlbench train --methods oidn",
    commit="abc",
    training_config='{"peak": 0.0005}',
    validation_history=((100, 21.5), (1200, 27.0)),
    note="stopped early",
)
PUBLISHED = ModelCard("oidn", origin="Intel's weights", command="python -m extract", note="no ours")


def net(seed: int = 1) -> nn.Linear:
    torch.manual_seed(seed)
    return nn.Linear(3, 2)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """Where the weights of `net()` are saved, and will be overwritten."""
    path = tmp_path / "cards" / "oidn.safetensors"
    save(net(), path, CARD)
    return path


def test_loaded_weights_are_the_saved_ones_rounded_to_float16(path):
    loaded = net(2)
    load_into(loaded, path)
    for mine, theirs in zip(loaded.parameters(), net().parameters(), strict=True):
        assert torch.equal(mine, theirs.half().float())
        assert mine.dtype == torch.float32
    assert safetensors.torch.load_file(path)["weight"].dtype == torch.float16


def test_the_card_is_plain_toml_that_states_hash_type_and_size_of_the_weights(path):
    card = save(net(), path, replace(CARD, seed=0, seconds=0.0))
    assert sorted(p.name for p in path.parent.iterdir()) == ["oidn.safetensors", "oidn.toml"]
    assert load_into(net(), path) == card
    assert save(net(), path, replace(CARD, seed=0, seconds=0.0)) == card  # equal files
    assert (card.data, card.validation_history) == (CARD.data, CARD.validation_history)
    assert card.sha256 == digest(path) == hashlib.sha256(path.read_bytes()).hexdigest()
    assert (card.dtype, card.parameters) == ("float16", 8)
    document = tomllib.loads(card_path(path).read_text())
    assert document.keys() == asdict(CARD).keys()
    assert (document["name"], document["seed"], document["seconds"]) == ("oidn", 0, 0.0)


def test_the_card_of_published_weights_has_no_fields_of_a_training(path):
    card = save(net(), path, replace(PUBLISHED, command=""))
    document = tomllib.loads(card_path(path).read_text())
    assert list(document) == ["name", "origin", "note", "licence", "sha256", "dtype", "parameters"]
    assert read_card(path) == card


def test_integer_buffers_keep_their_type(path):
    norm = nn.BatchNorm2d(3)
    norm.num_batches_tracked.fill_(70_001)
    save(norm, path, CARD)
    loaded = nn.BatchNorm2d(3)
    load_into(loaded, path)
    assert int(loaded.num_batches_tracked) == 70_001


def change(path: Path, card: ModelCard = CARD) -> None:
    save(net(), path, card)
    path.write_bytes(path.read_bytes() + b" ")


def rewrite(path: Path, content: bytes) -> None:
    """Replace the weights, and their hash on the card."""
    card = card_path(path).read_text().replace(digest(path), hashlib.sha256(content).hexdigest())
    path.write_bytes(content)
    card_path(path).write_text(card)


def spoil(path: Path, value: float) -> None:
    tensors = safetensors.torch.load_file(path)
    tensors["weight"][1, :2] = value
    rewrite(path, safetensors.torch.save(tensors))


REFUSED = {  # what happens to the files -> part of the message
    "changed": (change, "Train again with 'rlbench train --methods oidn'"),
    "changed, not trained here": (
        partial(change, card=PUBLISHED),
        "Restore both files, or repeat 'python -m extract'",
    ),
    "empty": (lambda path: path.write_bytes(b""), "is empty"),
    "no weights": (
        Path.unlink,
        r"\.safetensors is missing. Train the weights with 'rlbench train'",
    ),
    "no card": (lambda path: card_path(path).unlink(), r"\.toml is missing"),
    "no tensors": (lambda path: rewrite(path, b"none"), "not a safetensors file"),
    "another shape": (
        lambda path: save(nn.Linear(4, 2), path, CARD),
        r"'weight' has shape \[2, 4\], expected \[2, 3\]",
    ),
    "other names": (
        lambda path: save(nn.ParameterDict(net().state_dict() | {"c": torch.ones(1)}), path, CARD),
        r"missing nothing, unexpected \['c'\]",
    ),
    "fewer names": (
        lambda path: save(nn.Linear(3, 2, bias=False), path, CARD),
        r"missing \['bias'\], unexpected nothing",
    ),
    **{
        f"a value of {value}": (
            partial(spoil, value=value),
            r"oidn\.safetensors: tensor 'weight' has 2 of 6 values that are NaN or infinite",
        )
        for value in (float("nan"), float("inf"), -float("inf"))
    },
}


@pytest.mark.parametrize("case", REFUSED)
def test_weights_that_are_not_those_of_the_network_are_refused_and_change_nothing(path, case):
    damage, message = REFUSED[case]
    damage(path)
    module = net(2)
    with pytest.raises(WeightsError, match=message):
        load_into(module, path)
    for mine, before in zip(module.parameters(), net(2).parameters(), strict=True):
        assert torch.equal(mine, before)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("name = ", r"oidn\.toml is not a model card: .* is not TOML"),
        ('name = "x"\n', "missing fields: sha256"),
        ('name = "x"\nsha256 = "y"\ncolour = 1\n', "unknown fields: colour"),
        ('name = "x"\nsha256 = "y"\nsteps = "many"\n', "Expected `int`, got `str`.*steps"),
    ],
)
def test_a_broken_card_is_refused(path, text, message):
    card_path(path).write_text(text)
    with pytest.raises(WeightsError, match=message):
        load_into(net(), path)


def test_training_clips_are_the_names_on_the_card(path):
    save(net(), path, replace(CARD, data=("city 0123abcd", "temple night 4567", "hall")))
    assert training_clips(path) == {"city", "temple night", "hall"}
    save(net(), path, replace(CARD, data=("temple night", "hall"), data_digest="0123abcd"))
    assert training_clips(path) == {"temple night", "hall"}  # with one digest together
    card_path(path).unlink()
    assert training_clips(path) == training_clips(None) == frozenset()


@pytest.mark.parametrize("value", [1e5, float("nan")])
def test_weights_outside_float16_are_not_saved(tmp_path, value):
    module = net()
    nn.init.constant_(module.weight, value)
    with pytest.raises(WeightsError, match="'weight' has values that float16 cannot hold"):
        save(module, tmp_path / "new.safetensors", CARD)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("weights", "seed"), [(None, 1), ("random", 2), ("file", 3)])
def test_a_network_is_loaded_with_pretrained_random_or_given_weights(path, weights, seed):
    """Pretrained ones are of seed 1, the initial ones of seed 2, those of the file of seed 3."""
    own, other = net(2), path.with_name("other.safetensors")
    save(net(3), other, CARD)
    load_for_inference(own, str(other) if weights == "file" else weights, path, "cpu")
    torch.testing.assert_close(own.weight, net(seed).weight, rtol=1e-3, atol=0)  # float16
    assert not own.training
    assert not own.weight.requires_grad
