"""Initial weights: Intel's denoiser, an encoder that passes values on, a contrast-aware sampler."""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn

from baselines.accumulate.method import accumulated_network
from baselines.oidn.method import published_network, tuned_network, widen
from methods.ours import Config
from methods.ours.networks import (
    DEVIATION_INPUT,
    GBUFFER_CHANNELS,
    HISTORY_INPUTS,
    SAMPLE_ENCODINGS,
    Encoder,
    Networks,
    Sampler,
)
from rlbench.ops.init import kaiming_init
from rlbench.ops.unet_widths import BASE_WIDTHS, FAST_WIDTHS

RANDOM_SHARE = 0.1  # factor on the random weights that are left beside wired ones
TANH_LINEAR = 0.5  # up to here tanh is nearly linear

# sample slots whose mean passes through channels 0-2, 3-5, 6-8 and 9-11 of the state
SLOT_GROUPS = ((0,), (1,), (2, 3), (4, 5, 6, 7))
GBUFFER_OUTPUT = 12  # first state channel for normal, albedo and depth
HISTORY_OUTPUT = GBUFFER_OUTPUT + GBUFFER_CHANNELS  # and for accumulated radiance
INITIAL_TRUST = 0.7  # in accumulated radiance
INITIAL_BLEND = 0.3  # weight of the previous image
INITIAL_GATE = -3.0  # logit of the weight of filtered radiance: 5 %

STARTS = {"intel": published_network, "tuned": tuned_network, "accumulated": accumulated_network}
CONTRAST_GAIN = 20.0  # contrasts are about 0.1
MISSING_BELOW = 0.6  # a value below minus this is MISSING


@torch.no_grad()
def initialize(networks: Networks, config: Config, seed: int) -> str:
    """Set seeded initial weights; returns their origin for the model card, or "".

    The sampler starts uniform: from a random last layer, most actions lie beyond 0.8, where tanh is
    flat. In the paper's recipe its other layers are random; else `wire_contrast` sets them.
    The encoder starts with one hidden unit for each input value of samples and G-buffer, and a
    state channel for each group of slots and each G-buffer value: from random weights it hides its
    input behind a random projection, and thousands of steps are spent on undoing it, while its tanh
    saturates. What is left of its weights stays random. If the denoiser reads radiance and Intel
    has a network of its size, it starts from Intel's weights with zeros for the state: the first
    image is that of Open Image Denoise. If it reads the state alone, its weights are random.
    """
    kaiming_init(networks, seed)
    if networks.sampler is not None:
        if config.wired_contrast:
            wire_contrast(networks.sampler, config)
        networks.sampler.start_uniform()
    if networks.encoder is not None:
        _wire_identity(networks.encoder, config)
    origin = ""
    if config.accumulation != "none" and config.denoiser in (BASE_WIDTHS, FAST_WIDTHS):
        source, origin = STARTS[config.denoiser_start](config.denoiser)
        # outputs of a latent keep their random weights: where both what writes a latent and what
        # reads it is zero, neither has a gradient
        widen(networks.denoiser, source)
        networks.denoiser.dec_conv0.weight[3:4].zero_()  # of the blend
    if config.accumulates:
        _bias(networks.denoiser.dec_conv0)[3] = math.log(INITIAL_BLEND / (1 - INITIAL_BLEND))
    if config.kernel_taps:
        _bias(networks.denoiser.dec_conv0)[4 + config.latent] = INITIAL_GATE
    return origin


def _wire_identity(encoder: Encoder, config: Config) -> None:
    """One hidden unit for each value of samples, G-buffer and history, and outputs that read it."""
    first, *between, last = _convolutions(encoder.layers)
    samples = SAMPLE_ENCODINGS[config.sample_encoding].channels
    current = samples + GBUFFER_CHANNELS
    history = HISTORY_INPUTS * config.accumulates
    for channel in range(current + history):
        skipped = config.latent if channel >= current else 0
        _wire(first, channel, {channel + skipped: 1.0})
        for layer in between:
            _wire(layer, channel, {channel: 1.0})
    _bias(first)[samples : samples + 3] = 1  # normals are signed, hidden units are not
    if config.latent:
        _wire_slots(last, samples)
        for channel in range(GBUFFER_CHANNELS):
            _wire(last, GBUFFER_OUTPUT + channel, {samples + channel: TANH_LINEAR})
        _bias(last)[GBUFFER_OUTPUT : GBUFFER_OUTPUT + 3] = -TANH_LINEAR
        for channel in range(history):
            _wire(last, HISTORY_OUTPUT + channel, {current + channel: TANH_LINEAR})
    if config.accumulates:
        last.weight[config.latent :] *= RANDOM_SHARE
        _bias(last)[config.latent :] = math.atanh(2 * INITIAL_TRUST - 1)


def _wire_slots(last: nn.Conv2d, samples: int) -> None:
    """The first state channels show the mean of each group of sample slots."""
    slots = [group for group in SLOT_GROUPS if 3 * max(group) + 3 <= samples]
    for group, members in enumerate(slots):
        for colour in range(3):
            mean = {3 * slot + colour: TANH_LINEAR / len(members) for slot in members}
            _wire(last, 3 * group + colour, mean)


@torch.no_grad()
def wire_contrast(sampler: Sampler, config: Config) -> None:
    """Wire the sampler so that its last layers read local contrast and noise of the last frame.

    Behind random layers the policy gradient finds nothing in the training time available. The
    finest level starts with contrasts (value less its 3x3 mean, absolute), a brightness, and a mask
    of missing history. All pass the skip connection; two reach the last layer: contrast, and
    brightness or, with accumulated radiance, its deviation. Their use is learned. A sampler without
    a coarser level stays as it is.
    """
    if len(sampler.merge) == 0:
        return
    _wire_sources(sampler.tail, config)
    enter, leave = _convolutions(sampler.down[0])
    for to, (source, sign) in enumerate(((0, 1), (0, -1), (1, 1), (1, -1), (2, 1), (2, -1))):
        _wire(enter, to, {source: -sign * CONTRAST_GAIN}, box=True)
        enter.weight[to, source, 1, 1] += sign * CONTRAST_GAIN
    if config.accumulates:  # the deviation itself, not its contrast
        _wire(enter, 4, {2: 2.0})
        _wire(enter, 5, {2: 0.0})
    _wire(enter, 6, {0: 4.0})
    _wire(enter, 7, {0: -1 / (1 - MISSING_BELOW)})
    _bias(enter)[7] = -MISSING_BELOW / (1 - MISSING_BELOW)
    gather, forward = _convolutions(sampler.merge[-1])
    units = _UNITS_WITH_RADIANCE if config.accumulates else _UNITS
    for to, sources in enumerate(units):
        _wire(leave, to, dict.fromkeys(sources, 1.0), box=True)
        _wire(gather, to, {leave.out_channels + to: 1.0}, box=True)
        _wire(forward, to, {to: 1.0}, box=True)
    for to in range(2):
        _wire(sampler.head, to, {to: 1.0})


def _wire_sources(tail: nn.Conv2d, config: Config) -> None:
    """The first layer reads colour (or albedo), albedo, deviation (or normal), and depth."""
    colour = GBUFFER_CHANNELS if config.history_mode != "nothing" else 3
    other: tuple[int, ...] = (0, 1, 2)  # normals
    if config.accumulates:
        colour = GBUFFER_CHANNELS + config.latent
        other = (colour + DEVIATION_INPUT,)
    sources = [tuple(range(colour, colour + 3)), (3, 4, 5), other, (6,)]  # (3, 4, 5) is albedo
    for to, channels in enumerate(sources):
        _wire(tail, to, {channel: 1 / len(channels) for channel in channels})


# hidden units that each channel of the skip connection sums
_UNITS = ((0, 1), (6,), (7,), (2, 3), (4, 5))
_UNITS_WITH_RADIANCE = ((0, 1), (4, 5), (7,), (2, 3), (6,))


def _convolutions(block: nn.Module) -> list[nn.Conv2d]:
    return [layer for layer in block.children() if isinstance(layer, nn.Conv2d)]


def _bias(layer: nn.Conv2d) -> Tensor:
    assert layer.bias is not None
    return layer.bias


def _wire(layer: nn.Conv2d, to: int, sources: dict[int, float], box: bool = False) -> None:
    """Make output `to` a weighted sum of inputs or, with `box`, of their means over the kernel."""
    weight = layer.weight
    side = weight.shape[-1]
    weight[to] *= RANDOM_SHARE
    for source, gain in sources.items():
        weight[to, source] = gain / side**2 if box else 0.0
        if not box:
            weight[to, source, side // 2, side // 2] = gain
