"""Weights are loaded exactly as they were saved, or refused."""

from __future__ import annotations

import hashlib
import tomllib
from dataclasses import asdict, replace
from pathlib import Path

import pytest
import safetensors.torch
import torch
from torch import nn

from rlbench.ops.unet import UNet
from rlbench.ops.unet_widths import FAST_WIDTHS
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


def net(seed: int = 1) -> UNet:
    return UNet(4, widths=FAST_WIDTHS, seed=seed)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "cards" / "oidn.safetensors"


def test_loaded_weights_are_the_saved_ones_rounded_to_float16(path):
    save(net(), path, CARD)
    loaded = net(2)
    load_into(loaded, path)
    for mine, theirs in zip(loaded.parameters(), net().parameters(), strict=True):
        assert torch.equal(mine, theirs.half().float())
        assert mine.dtype == torch.float32
    assert safetensors.torch.load_file(path)["enc_conv0.weight"].dtype == torch.float16


def test_the_card_is_plain_toml_that_states_hash_type_and_size_of_the_weights(path):
    card = save(net(), path, replace(CARD, seed=0, seconds=0.0))
    assert sorted(p.name for p in path.parent.iterdir()) == ["oidn.safetensors", "oidn.toml"]
    assert load_into(net(), path) == card
    assert save(net(), path, replace(CARD, seed=0, seconds=0.0)) == card  # equal files
    assert (card.data, card.validation_history) == (CARD.data, CARD.validation_history)
    assert card.sha256 == digest(path) == hashlib.sha256(path.read_bytes()).hexdigest()
    assert card.dtype == "float16"
    assert card.parameters == sum(p.numel() for p in net().parameters())
    document = tomllib.loads(card_path(path).read_text())
    assert document.keys() == asdict(CARD).keys()
    assert (document["name"], document["seed"], document["seconds"]) == ("oidn", 0, 0.0)


def test_the_card_of_published_weights_has_no_fields_of_a_training(path):
    card = save(net(), path, ModelCard("oidn", origin="Intel's weights", note="not trained here"))
    document = tomllib.loads(card_path(path).read_text())
    assert list(document) == ["name", "origin", "note", "licence", "sha256", "dtype", "parameters"]
    assert read_card(path) == card


@pytest.mark.parametrize(
    ("card", "remedy"),
    [
        (CARD, "Train again with 'rlbench train --methods oidn'"),
        (
            ModelCard("oidn", origin="Intel's weights", command="python -m extract"),
            "Restore both files, or repeat 'python -m extract'",
        ),
    ],
)
def test_changed_weights_are_an_error_with_a_remedy_that_fits_their_card(path, card, remedy):
    save(net(), path, card)
    path.write_bytes(path.read_bytes() + b" ")
    with pytest.raises(WeightsError, match=remedy):
        load_into(net(), path)


def test_integer_buffers_keep_their_type(path):
    norm = nn.BatchNorm2d(3)
    norm.num_batches_tracked.fill_(70_001)
    save(norm, path, CARD)
    loaded = nn.BatchNorm2d(3)
    load_into(loaded, path)
    assert int(loaded.num_batches_tracked) == 70_001


@pytest.mark.parametrize("suffix", [".safetensors", ".toml"])
def test_a_missing_file_is_an_error_that_says_how_to_make_it(path, suffix):
    save(net(), path, CARD)
    path.with_suffix(suffix).unlink()
    with pytest.raises(
        WeightsError, match=f"{suffix} is missing. Train the weights with 'rlbench train'"
    ):
        load_into(net(), path)


def test_a_refused_file_changes_nothing(path):
    save(UNet(5, widths=FAST_WIDTHS), path, CARD)
    before, module = net(), net()
    with pytest.raises(WeightsError, match=r"'enc_conv0.weight' has shape \[32, 5, 3, 3\]"):
        load_into(module, path)
    for mine, theirs in zip(module.parameters(), before.parameters(), strict=True):
        assert torch.equal(mine, theirs)


def test_other_names_are_refused_and_listed(path):
    save(nn.ModuleDict({"a": nn.Linear(1, 1), "b": nn.Linear(1, 1)}), path, CARD)
    module = nn.ModuleDict({"a": nn.Linear(1, 1), "c": nn.Linear(1, 1)})
    with pytest.raises(WeightsError, match=r"missing \['c.bias', 'c.weight'\].*'b.bias'"):
        load_into(module, path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("name = ", r"oidn\.toml is not a model card: .* is not TOML"),
        ('name = "x"\n', "missing fields: sha256"),
        ('name = "x"\nsha256 = "y"\ncolour = 1\n', "unknown fields: colour"),
        ('name = "x"\nsha256 = "y"\nsteps = "many"\n', "Expected `int`, got `str`.*steps"),
        (f"name = {'[' * 2000}", r"oidn\.toml is not a model card: .* is not TOML"),
        ('name = "x"\nsha256 = 1979-05-27\n', "Expected `str`, got `date`.*sha256"),
        ('name = "x"\nsha256 = "y"\nvalidation_history = [[1]]\n', "length 2.*validation_history"),
    ],
)
def test_a_broken_card_is_refused(path, text, message):
    save(net(), path, CARD)
    card_path(path).write_text(text)
    with pytest.raises(WeightsError, match=message):
        load_into(net(), path)


def test_training_clips_are_the_names_on_the_card(path):
    save(net(), path, replace(CARD, data=("city 0123abcd", "temple night 4567", "hall")))
    assert training_clips(path) == {"city", "temple night", "hall"}
    save(net(), path, replace(CARD, data=("temple night", "hall"), data_digest="0123abcd"))
    assert training_clips(path) == {"temple night", "hall"}  # with one digest together


@pytest.mark.parametrize("suffix", [".safetensors", ".toml"])
def test_weights_without_a_readable_card_have_no_training_clips(path, suffix):
    assert training_clips(None) == frozenset()
    save(net(), path, CARD)
    path.with_suffix(suffix).unlink()
    assert training_clips(path) == frozenset()


def test_a_file_that_is_not_safetensors_is_refused(path):
    card = save(net(), path, CARD)
    path.write_bytes(b"no tensors here")
    text = card_path(path).read_text().replace(card.sha256, digest(path))
    card_path(path).write_text(text)
    with pytest.raises(WeightsError, match="not a safetensors file"):
        load_into(net(), path)


@pytest.mark.parametrize("value", [1e5, float("nan")])
def test_weights_outside_float16_are_not_saved(path, value):
    module = nn.Linear(1, 1)
    nn.init.constant_(module.weight, value)
    with pytest.raises(WeightsError, match="'weight' has values that float16 cannot hold"):
        save(module, path, CARD)
    assert not path.exists()


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf")])
def test_weights_that_are_not_finite_are_refused_with_tensor_and_count(path, value):
    card = save(nn.Linear(3, 2), path, CARD)
    tensors = safetensors.torch.load_file(path)
    tensors["weight"][1, :2] = value
    safetensors.torch.save_file(tensors, path)
    card_path(path).write_text(card_path(path).read_text().replace(card.sha256, digest(path)))
    module = nn.Linear(3, 2)
    before = module.weight.detach().clone()
    message = r"oidn\.safetensors: tensor 'weight' has 2 of 6 values that are NaN or infinite"
    with pytest.raises(WeightsError, match=message):
        load_into(module, path)
    assert torch.equal(module.weight, before)


@pytest.mark.parametrize("weights", [None, "random", "file"])
def test_a_network_is_loaded_with_pretrained_random_or_given_weights(tmp_path, weights):
    own, shipped, other = (nn.Linear(2, 1) for _ in range(3))
    before = own.weight.detach().half().float()
    save(shipped, tmp_path / "shipped.safetensors", ModelCard("shipped"))
    save(other, tmp_path / "other.safetensors", ModelCard("other"))
    given = str(tmp_path / "other.safetensors") if weights == "file" else weights
    load_for_inference(own, given, tmp_path / "shipped.safetensors", "cpu")
    expected = {
        None: shipped.weight.half().float(),
        "random": before,
        "file": other.weight.half(),
    }[weights]
    torch.testing.assert_close(own.weight, expected.float(), rtol=1e-3, atol=0)  # float16
    assert not own.training
    assert not own.weight.requires_grad
