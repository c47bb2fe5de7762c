"""Weights come back as they were saved, or not at all."""

from __future__ import annotations

import hashlib
import tomllib
from pathlib import Path

import pytest
import safetensors.torch
import torch
from torch import nn

from rlbench.ops.unet import SMALL, UNet
from rlbench.weights import (
    ModelCard,
    WeightsError,
    card_path,
    digest,
    load_for_inference,
    load_into,
    save,
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
    return UNet(4, widths=SMALL, seed=seed)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "cards" / "oidn.safetensors"


def test_weights_come_back_to_half_precision(path):
    save(net(), path, CARD)
    loaded = net(2)
    load_into(loaded, path)
    for mine, theirs in zip(loaded.parameters(), net().parameters(), strict=True):
        assert torch.equal(mine, theirs.half().float())
        assert mine.dtype == torch.float32


def test_the_card_comes_back_whole(path):
    written = save(net(), path, CARD)
    assert load_into(net(), path) == written
    assert written.data == CARD.data
    assert written.validation_history == CARD.validation_history


def test_the_card_says_what_the_file_is(path):
    card = save(net(), path, CARD)
    assert card.sha256 == digest(path) == hashlib.sha256(path.read_bytes()).hexdigest()
    assert card.dtype == "float16"
    assert card.parameters == sum(p.numel() for p in net().parameters())


def test_the_card_is_plain_toml_beside_the_weights(path):
    save(net(), path, CARD)
    found = tomllib.loads(card_path(path).read_text())
    assert (found["name"], found["seed"], found["seconds"]) == ("oidn", 3, 12.5)
    assert card_path(path) == path.parent / "oidn.toml"


def test_equal_weights_make_equal_files(path, tmp_path):
    first, second = (save(net(), p, CARD) for p in (path, tmp_path / "again.safetensors"))
    assert first == second


def test_saving_leaves_nothing_else_behind(path):
    save(net(), path, CARD)
    assert sorted(p.name for p in path.parent.iterdir()) == ["oidn.safetensors", "oidn.toml"]


def test_any_safetensors_reader_can_read_them(path):
    save(net(), path, CARD)
    assert safetensors.torch.load_file(path)["enc_conv0.weight"].dtype == torch.float16


def test_integer_buffers_keep_their_type(path):
    norm = nn.BatchNorm2d(3)
    norm.num_batches_tracked.fill_(70_001)
    save(norm, path, CARD)
    loaded = nn.BatchNorm2d(3)
    load_into(loaded, path)
    assert int(loaded.num_batches_tracked) == 70_001


@pytest.mark.parametrize("suffix", [".safetensors", ".toml"])
def test_a_missing_file_says_what_makes_it(path, suffix):
    save(net(), path, CARD)
    path.with_suffix(suffix).unlink()
    with pytest.raises(WeightsError, match="missing; 'rlbench train' makes them"):
        load_into(net(), path)


def test_a_changed_file_is_refused(path):
    save(net(), path, CARD)
    content = bytearray(path.read_bytes())
    content[-1] ^= 1
    path.write_bytes(content)
    with pytest.raises(WeightsError, match="its card says"):
        load_into(net(), path)


def test_a_card_of_other_weights_is_refused(path, tmp_path):
    save(net(), path, CARD)
    save(net(2), tmp_path / "other.safetensors", CARD)
    (tmp_path / "other.toml").replace(card_path(path))
    with pytest.raises(WeightsError, match="hash"):
        load_into(net(), path)


def test_a_refused_file_changes_nothing(path):
    save(UNet(5, widths=SMALL), path, CARD)
    before, module = net(), net()
    with pytest.raises(WeightsError, match=r"'enc_conv0.weight' has shape \[32, 5, 3, 3\]"):
        load_into(module, path)
    for mine, theirs in zip(module.parameters(), before.parameters(), strict=True):
        assert torch.equal(mine, theirs)


def test_other_names_are_refused_and_listed(path):
    save(nn.ModuleDict({"a": nn.Linear(1, 1), "b": nn.Linear(1, 1)}), path, CARD)
    wanted = nn.ModuleDict({"a": nn.Linear(1, 1), "c": nn.Linear(1, 1)})
    with pytest.raises(WeightsError, match=r"missing \['c.bias', 'c.weight'\].*'b.bias'"):
        load_into(wanted, path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("name = ", "not a card"),
        ('name = "x"\n', "lacks: sha256"),
        ('name = "x"\nsha256 = "y"\ncolour = 1\n', "unknown fields: colour"),
    ],
)
def test_a_broken_card_is_refused(path, text, message):
    save(net(), path, CARD)
    card_path(path).write_text(text)
    with pytest.raises(WeightsError, match=message):
        load_into(net(), path)


def test_a_file_that_is_no_safetensors_is_refused(path):
    card = save(net(), path, CARD)
    path.write_bytes(b"no tensors here")
    text = card_path(path).read_text().replace(card.sha256, digest(path))
    card_path(path).write_text(text)
    with pytest.raises(WeightsError, match="not a safetensors file"):
        load_into(net(), path)


@pytest.mark.parametrize("value", [1e5, float("nan")])
def test_weights_that_half_floats_cannot_hold_are_not_saved(path, value):
    module = nn.Linear(1, 1)
    nn.init.constant_(module.weight, value)
    with pytest.raises(WeightsError, match="'weight' has values that half floats cannot hold"):
        save(module, path, CARD)
    assert not path.exists()


@pytest.mark.parametrize("asked", [None, "random", "file"])
def test_a_network_is_equipped_with_what_was_asked_for(tmp_path, asked):
    own, shipped, other = (nn.Linear(2, 1) for _ in range(3))
    before = own.weight.detach().half().float()
    save(shipped, tmp_path / "shipped.safetensors", ModelCard("shipped"))
    save(other, tmp_path / "other.safetensors", ModelCard("other"))
    given = str(tmp_path / "other.safetensors") if asked == "file" else asked
    load_for_inference(own, given, tmp_path / "shipped.safetensors", "cpu")
    wanted = {None: shipped.weight.half().float(), "random": before, "file": other.weight.half()}
    torch.testing.assert_close(own.weight, wanted[asked].float(), rtol=1e-3, atol=0)  # half floats
    assert not own.training
    assert not own.weight.requires_grad
