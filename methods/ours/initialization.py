"""Where training begins: Intel's denoiser, an encoder that passes on, a sampler shown contrast."""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn

from methods.ours.networks import HISTORY_INPUTS, SPREAD, VIEW, Encoder, Networks, Sampler
from methods.ours.variants import SAMPLES, Config
from rlbench.ops.init import kaiming_init
from rlbench.ops.unet import BASE, FAST, UNet

FAINT = 0.1  # share of a random weight that is left beside a wired one
LINEAR = 0.5  # where tanh is nearly a line

SLOTS = ((0,), (1,), (2, 3), (4, 5, 6, 7))  # of samples, by channels 0-2, 3-5, 6-8, 9-11 of state
SEEN = 12  # the state's first channel for normal, albedo and depth
GAINED = SEEN + VIEW  # and for what was gathered before
TRUST, KEPT = 0.7, 0.3  # shares of light gathered before, and of the last image

NOTICED = 20.0  # gain of contrasts, which are about a tenth
LOST = 0.6  # a value that lies below minus this is not there


@torch.no_grad()
def start(networks: Networks, config: Config, seed: int) -> str:
    """Seeded weights, a uniform sampler, an encoder that passes samples and view on.

    From random weights the encoder hides its input behind a random projection, and thousands of
    steps are spent on undoing it, while its tanh saturates. So it starts with one hidden unit for
    each value of samples and view, and a channel of the state for each group of slots and each
    value of the view; what is left of both stays random. Where the denoiser reads colour and is of
    a size that Intel has, it starts with Intel's weights, to which the state says nothing yet: the
    first image is that of Open Image Denoise. Where it reads the state alone, its last three layers
    are wired to the first slot, averaged over 3x3 twice. Returns what a card says of weights that
    are not ours, or nothing. Raises LibraryError where Intel's weights are wanted and the extra
    `oidn` is not installed.
    """
    kaiming_init(networks, seed)
    if networks.sampler is not None:
        show_contrast(networks.sampler, config)
        networks.sampler.start_uniform()
    if networks.encoder is not None:
        _pass_on(networks.encoder, config)
    origin = ""
    if config.light == "none":
        _blur(networks.denoiser)
    elif config.denoiser in (BASE, FAST):
        origin = _adopt(networks.denoiser)
    if config.gathers:
        _bias(networks.denoiser.dec_conv0)[3:] = math.log(KEPT / (1 - KEPT))
    return origin


def _pass_on(encoder: Encoder, config: Config) -> None:
    first, *between, last = _convolutions(encoder.layers)
    values = SAMPLES[config.samples]
    slots = [group for group in SLOTS if 3 * max(group) + 3 <= values]
    before = HISTORY_INPUTS * config.gathers
    hidden = values + VIEW + before
    for channel in range(hidden):
        skipped = config.latent if channel >= values + VIEW else 0
        _wire(first, channel, {channel + skipped: 1.0})
        for layer in between:
            _wire(layer, channel, {channel: 1.0})
    _bias(first)[values : values + 3] = 1  # normals are signed, hidden units are not
    for group, members in enumerate(slots):
        for colour in range(3):
            mean = {3 * slot + colour: LINEAR / len(members) for slot in members}
            _wire(last, 3 * group + colour, mean)
    for channel in range(VIEW):
        _wire(last, SEEN + channel, {values + channel: LINEAR})
    _bias(last)[SEEN : SEEN + 3] = -LINEAR
    for channel in range(before):
        _wire(last, GAINED + channel, {values + VIEW + channel: LINEAR})
    if config.gathers:
        last.weight[config.latent :] *= FAINT
        _bias(last)[config.latent :] = math.atanh(2 * TRUST - 1)


def _blur(denoiser: UNet) -> None:
    skip = denoiser.dec_conv1a.in_channels - denoiser.enc_conv0.in_channels  # the state comes last
    for colour in range(3):
        _wire(denoiser.dec_conv1a, colour, {skip + colour: 1.0}, box=True)
        _wire(denoiser.dec_conv1b, colour, {colour: 1.0}, box=True)
        _wire(denoiser.dec_conv0, colour, {colour: 1 / LINEAR})


def _adopt(denoiser: UNet) -> str:
    from baselines.oidn_intel.networks import network, origin  # an extra; only training needs it

    theirs = network(denoiser.widths).state_dict()
    for name, weight in denoiser.state_dict().items():
        weight.zero_()
        known = weight[: len(theirs[name])]  # what is kept of the last image is said last
        known = known if weight.dim() == 1 else known[:, : theirs[name].shape[1]]
        known.copy_(theirs[name])  # the state is read last
    return origin()


@torch.no_grad()
def show_contrast(sampler: Sampler, config: Config) -> None:
    """Show the last layers where the last frame's picture was rough, and how noisy its light.

    Behind random layers the policy gradient finds nothing in the time that training has here. So
    the finest level starts with contrasts (value less its 3x3 mean, absolute), a brightness, and
    where there is nothing remembered; all pass the skip, and two reach the last layer: contrast,
    and brightness or the spread of the light. What it makes of them is learned.
    """
    if len(sampler.merge) == 0:
        return
    colour = VIEW if config.remembers != "nothing" else 3  # of what was shown, else albedo
    other: tuple[int, ...] = (0, 1, 2)  # normals
    if config.gathers:
        colour, other = VIEW + config.latent, (VIEW + config.latent + SPREAD,)
    sources = [tuple(range(colour, colour + 3)), (3, 4, 5), other, (6,)]  # (3, 4, 5) is albedo
    for to, channels in enumerate(sources):
        _wire(sampler.tail, to, {channel: 1 / len(channels) for channel in channels})
    enter, leave = _convolutions(sampler.down[0])
    for to, (source, sign) in enumerate(((0, 1), (0, -1), (1, 1), (1, -1), (2, 1), (2, -1))):
        _wire(enter, to, {source: -sign * NOTICED}, box=True)
        enter.weight[to, source, 1, 1] += sign * NOTICED
    if config.gathers:  # the spread as it is
        _wire(enter, 4, {2: 2.0})
        _wire(enter, 5, {2: 0.0})
    _wire(enter, 6, {0: 4.0})
    _wire(enter, 7, {0: -1 / (1 - LOST)})
    _bias(enter)[7] = -LOST / (1 - LOST)
    gather, forward = _convolutions(sampler.merge[-1])
    shown = ((0, 1), (4, 5), (7,), (2, 3), (6,)) if config.gathers else _PAPER
    for to, units in enumerate(shown):
        _wire(leave, to, dict.fromkeys(units, 1.0), box=True)
        _wire(gather, to, {leave.out_channels + to: 1.0}, box=True)
        _wire(forward, to, {to: 1.0}, box=True)
    for to in range(2):
        _wire(sampler.head, to, {to: 1.0})


_PAPER = ((0, 1), (6,), (7,), (2, 3), (4, 5))


def _convolutions(block: nn.Module) -> list[nn.Conv2d]:
    return [layer for layer in block.children() if isinstance(layer, nn.Conv2d)]


def _bias(layer: nn.Conv2d) -> Tensor:
    assert layer.bias is not None
    return layer.bias


def _wire(layer: nn.Conv2d, to: int, sources: dict[int, float], box: bool = False) -> None:
    """Make output `to` of a convolution a weighted sum of inputs, or of their means in its box."""
    weight = layer.weight
    side = weight.shape[-1]
    weight[to] *= FAINT
    for source, gain in sources.items():
        weight[to, source] = gain / side**2 if box else 0.0
        if not box:
            weight[to, source, side // 2, side // 2] = gain
