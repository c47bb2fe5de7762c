"""Weights of one network are averaged weight by weight, and their card names the parts."""

import pytest
import torch
from torch import nn

from rlbench.training.average import average_weights, main
from rlbench.weights import ModelCard, WeightsError, load_into, save


def write_net(path, seed, width=3, **card):
    torch.manual_seed(seed)
    net = nn.Sequential(nn.Conv2d(width, 4, 3), nn.Conv2d(4, 1, 1))
    save(net, path, ModelCard(name=path.stem, **card))
    return path


def test_the_average_of_linear_networks_gives_the_average_of_their_outputs(tmp_path):
    files = [write_net(tmp_path / f"{n}.safetensors", n) for n in range(2)]
    # only the last layer differs, so that the network is linear in what is averaged
    first, second = (nn.Sequential(nn.Conv2d(3, 4, 3), nn.Conv2d(4, 1, 1)) for _ in files)
    second[0].load_state_dict(first[0].state_dict())
    for net, file in zip((first, second), files, strict=True):
        save(net, file, ModelCard(name=file.stem))
    average_weights([(0.25, files[0]), (0.75, files[1])], tmp_path / "mean.safetensors", "command")
    averaged = nn.Sequential(nn.Conv2d(3, 4, 3), nn.Conv2d(4, 1, 1))
    load_into(averaged, tmp_path / "mean.safetensors")
    image = torch.rand(1, 3, 8, 8)
    # weights are stored as float16: relative rounding of 5e-4
    expected = 0.25 * first(image) + 0.75 * second(image)
    torch.testing.assert_close(averaged(image), expected, rtol=2e-3, atol=2e-3)


def test_the_card_names_the_parts_their_clips_and_the_command(tmp_path):
    parts = [
        write_net(tmp_path / "a.safetensors", 0, data=("hall 1", "city 2"), frames_seen=10),
        write_net(tmp_path / "b.safetensors", 1, data=("city 2", "room 3"), frames_seen=5),
    ]
    main([str(tmp_path / "mean.safetensors"), f"0.5*{parts[0]}", f"0.5*{parts[1]}"])
    card = load_into(
        nn.Sequential(nn.Conv2d(3, 4, 3), nn.Conv2d(4, 1, 1)), tmp_path / "mean.safetensors"
    )
    assert card.data == ("hall 1", "city 2", "room 3")
    assert card.frames_seen == 15
    assert "0.5 of a, 0.5 of b" in card.note
    assert card.command.startswith("python -m rlbench.training.average ")


@pytest.mark.parametrize(
    ("shares", "width", "word"), [((0.5, 0.6), 3, "sum to 1"), ((0.5, 0.5), 2, "other tensors")]
)
def test_shares_and_shapes_must_fit(tmp_path, shares, width, word):
    files = [
        write_net(tmp_path / "a.safetensors", 0),
        write_net(tmp_path / "b.safetensors", 1, width),
    ]
    with pytest.raises(WeightsError, match=word):
        average_weights(list(zip(shares, files, strict=True)), tmp_path / "mean.safetensors", "")
    assert not (tmp_path / "mean.safetensors").exists()


@pytest.mark.parametrize("part", ["0.5", "half*a.safetensors", "0.5*absent.safetensors"])
def test_a_part_that_cannot_be_read_is_an_error_of_the_command_line(tmp_path, part, capsys):
    with pytest.raises(SystemExit, match="2"):
        main([str(tmp_path / "mean.safetensors"), part, part])
    assert "safetensors" in capsys.readouterr().err
