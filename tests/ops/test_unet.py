"""The U-Net equals Open Image Denoise's in sizes, names and shapes; gradients, initialization."""

from __future__ import annotations

import pytest
import torch
from torch import nn

from rlbench.ops.unet import UNet
from rlbench.ops.unet_widths import BASE_WIDTHS, FAST_WIDTHS, UNetWidths

SMALL_WIDTHS = UNetWidths(32, 24, 32, 40, 48, (56, 56), (48, 48), (32, 32), (32, 16))
NAMES = [
    *(f"enc_conv{level}" for level in (0, 1, 2, 3, 4, "5a", "5b")),
    *(f"dec_conv{level}{half}" for level in (4, 3, 2, 1) for half in "ab"),
    "dec_conv0",
]


@pytest.mark.parametrize(
    ("inputs", "widths", "parameters"),
    [
        (3, BASE_WIDTHS, 914_627),
        (7, BASE_WIDTHS, 918_083),
        (9, BASE_WIDTHS, 919_811),  # in half precision, the size of OIDN's own weights file
        (32, BASE_WIDTHS, 939_683),
        (32, SMALL_WIDTHS, 261_939),
        (9, FAST_WIDTHS, 320_035),
    ],
)
def test_parameter_counts_equal_the_published_ones(inputs, widths, parameters):
    assert sum(p.numel() for p in UNet(inputs, widths=widths).parameters()) == parameters


def test_layers_have_the_official_names_in_order():
    assert [name for name, _ in UNet(9).named_children()] == NAMES


def test_sides_are_halved_four_times_and_doubled_back():
    with torch.device("meta"):
        net = UNet(9)
        sides: dict[str, int] = {}
        for name, layer in net.named_children():
            layer.register_forward_hook(
                lambda _l, _i, y, name=name: sides.update({name: y.size(3)})
            )
        image = net(torch.empty(1, 9, 720, 720))
    down = [sides[f"enc_conv{i}"] for i in ("1", "2", "3", "4", "5a")]
    up = [sides[f"dec_conv{i}"] for i in ("4a", "3a", "2a", "1a", "0")]
    assert (down, up) == ([720, 360, 180, 90, 45], [90, 180, 360, 720, 720])
    assert image.shape == (1, 3, 720, 720)


def test_decoder_features_are_ordered_coarse_to_fine_with_the_documented_channels():
    net = UNet(9, widths=SMALL_WIDTHS)
    shapes = [tuple(x.shape) for x in net.decoder_features(torch.zeros(2, 9, 32, 48))]
    assert shapes == [
        (2, SMALL_WIDTHS.dec4[1], 4, 6),
        (2, SMALL_WIDTHS.dec3[1], 8, 12),
        (2, SMALL_WIDTHS.dec2[1], 16, 24),
        (2, SMALL_WIDTHS.dec1[1], 32, 48),
    ]


def test_the_output_is_the_last_convolution_of_the_finest_features():
    """It is linear: outputs can be negative."""
    net, x = UNet(4, widths=SMALL_WIDTHS), torch.rand(1, 4, 16, 32)
    torch.testing.assert_close(net(x), net.dec_conv0(net.decoder_features(x)[-1]))
    assert net(x).min() < 0


def test_the_top_skip_is_the_raw_input():
    """The second input of the first layer of the top level is the input of the network."""
    net = UNet(3, widths=SMALL_WIDTHS)
    with torch.no_grad():
        net.dec_conv2b.weight.zero_()
    x = torch.rand(1, 3, 16, 16)
    skips: list[torch.Tensor] = []
    net.dec_conv1a.register_forward_hook(lambda _l, inputs, _y: skips.append(inputs[1]))
    net(x)
    assert torch.equal(skips[0], x)


@pytest.mark.parametrize("side", [16, 32])
def test_gradients_reach_every_parameter(side):
    net = UNet(9)
    net(torch.rand(1, 9, side, side)).square().sum().backward()
    missing = [k for k, p in net.named_parameters() if p.grad is None or not p.grad.any()]
    assert missing == []


def test_weights_depend_on_the_seed_alone():
    torch.manual_seed(1)
    before = torch.random.get_rng_state()
    first = UNet(9, seed=5)
    assert torch.equal(before, torch.random.get_rng_state())
    second = UNet(9, seed=5)
    other = UNet(9, seed=6)
    for layer in NAMES:
        weights = [getattr(net, layer).weight for net in (first, second, other)]
        assert torch.equal(weights[0], weights[1])
        assert not torch.equal(weights[0], weights[2])


@pytest.mark.parametrize("layer", ["enc_conv2", "dec_conv4a", "dec_conv1b"])
def test_initial_weights_are_he_normal(layer):
    """The standard deviation equals that of torch's kaiming_normal_."""
    weight = getattr(UNet(9), layer).weight.detach()
    theirs = nn.init.kaiming_normal_(torch.empty_like(weight), nonlinearity="relu").std()
    # relative error of a deviation of N numbers is about 1 / sqrt(2 N), twice, N >= 13,824
    assert float(weight.std() / theirs) == pytest.approx(1, abs=0.04)
    assert not getattr(UNet(9), layer).bias.any()
