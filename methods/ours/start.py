"""Where training begins: with what is seen passed on, and a blur of the first samples shown."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from methods.ours.network import AUX, Networks, Sampler
from rlbench.ops.initialise import initialise

FAINT = 0.1  # share of a random weight that is left beside a wired one
LINEAR = 0.5  # where tanh is nearly a line

SLOTS = ((0,), (1,), (2, 3), (4, 5, 6, 7))  # of samples, by channels 0-2, 3-5, 6-8, 9-11 of state
VIEW = 12  # the state's first channel for normal, albedo and depth

NOTICED = 20.0  # gain of contrasts, which are about a tenth
LOST = 0.6  # a first sample that lies below minus this is not missing, but has no state


@torch.no_grad()
def start(networks: Networks, seed: int) -> None:
    """Seeded weights, a uniform sampler, and a path that shows the first samples, blurred.

    From random weights the encoder hides its input behind a random projection, and thousands of
    steps are spent on undoing it, while its tanh saturates. So the encoder starts with one hidden
    unit for each value of samples and view, and a channel of the state for each group of slots and
    each value of the view; what is left of both stays random. The denoiser's last three layers are
    wired to the first slot, averaged over 3x3 twice.
    """
    initialise(networks, seed)
    if networks.sampler is not None:
        _show_contrast(networks.sampler)
        networks.sampler.start_uniform()
    first, second, denoiser = networks.encoder.first, networks.encoder.second, networks.denoiser
    slots = [slot for group in SLOTS for slot in group]
    view = 3 * len(slots)  # of the encoder's input: normal 3, albedo 3, depth 1
    for channel in range(view + 7):
        _wire(first.weight, channel, {channel: 1.0})
    assert first.bias is not None
    first.bias[view : view + 3] = 1  # normals are signed, hidden units are not
    for group, members in enumerate(SLOTS):
        for colour in range(3):
            mean = {3 * slot + colour: LINEAR / len(members) for slot in members}
            _wire(second.weight, 3 * group + colour, mean)
    for channel in range(7):
        _wire(second.weight, VIEW + channel, {view + channel: LINEAR})
    assert second.bias is not None
    second.bias[VIEW : VIEW + 3] = -LINEAR
    skip = denoiser.dec_conv1a.in_channels - second.out_channels  # the state comes last
    for colour in range(3):
        _wire(denoiser.dec_conv1a.weight, colour, {skip + colour: 1.0}, box=True)
        _wire(denoiser.dec_conv1b.weight, colour, {colour: 1.0}, box=True)
        _wire(denoiser.dec_conv0.weight, colour, {colour: 1 / LINEAR})


@torch.no_grad()
def _show_contrast(sampler: Sampler) -> None:
    """Show the last layers local contrast and brightness of the last frame's first sample.

    Behind random layers the policy gradient finds nothing in the time that training has here. So
    the finest level starts with the contrasts (value less its 3x3 mean, absolute) of sample, albedo
    and normal, the brightness of the sample, and where there is no state; all pass the skip, and
    contrast and brightness of the sample reach the last layer. What it makes of them is learned.
    """
    sources = [(AUX, AUX + 1, AUX + 2), (3, 4, 5), (0, 1, 2), (6,)]  # state, albedo, normal, depth
    for to, channels in enumerate(sources):
        _wire(sampler.tail.weight, to, {channel: 1 / len(channels) for channel in channels})
    enter, leave = _convolutions(sampler.down[0])
    for to, (source, sign) in enumerate(((0, 1), (0, -1), (1, 1), (1, -1), (2, 1), (2, -1))):
        _wire(enter.weight, to, {source: -sign * NOTICED}, box=True)
        enter.weight[to, source, 1, 1] += sign * NOTICED
    _wire(enter.weight, 6, {0: 4.0})
    _wire(enter.weight, 7, {0: -1 / (1 - LOST)})
    assert enter.bias is not None
    enter.bias[7] = -LOST / (1 - LOST)
    gather, forward = _convolutions(sampler.merge[-1])
    for to, units in enumerate(((0, 1), (6,), (7,), (2, 3), (4, 5))):
        _wire(leave.weight, to, dict.fromkeys(units, 1.0), box=True)
        _wire(gather.weight, to, {leave.out_channels + to: 1.0}, box=True)
        _wire(forward.weight, to, {to: 1.0}, box=True)
    for to in range(2):
        _wire(sampler.head.weight, to, {to: 1.0})


def _convolutions(block: nn.Module) -> list[nn.Conv2d]:
    return [layer for layer in block.children() if isinstance(layer, nn.Conv2d)]


def _wire(weight: Tensor, to: int, sources: dict[int, float], box: bool = False) -> None:
    """Make output `to` of a 3x3 convolution a weighted sum of inputs, or of their 3x3 means."""
    weight[to] *= FAINT
    for source, gain in sources.items():
        weight[to, source] = gain / 9 if box else 0.0
        if not box:
            weight[to, source, 1, 1] = gain
