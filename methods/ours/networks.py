"""The three networks, layer by layer, and how samples enter them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import pairwise
from typing import Literal, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional as F

from methods.ours import SLOTS, Config
from rlbench.frames import Samples
from rlbench.ops.memory_format import to_channels_last
from rlbench.ops.transfer import log_forward
from rlbench.ops.unet import UNet

MISSING = -1.0  # marks an empty sample slot, or a state without valid history
GBUFFER_CHANNELS = 7  # normal 3, albedo 3, depth 1
DENOISER_INPUTS = 9  # of Open Image Denoise: colour 3, albedo 3, normal 3
# of accumulated radiance: previous image 3, mean 3, relative deviation 1, weight 1, similarity 1
HISTORY_INPUTS = 9
RADIANCE_FEATURES = 6  # previous image 3, relative deviation 1, weight 1, similarity 1
DEVIATION_INPUT = 6  # index of the relative deviation in these


class SampleEncoding(NamedTuple):
    """How a varying number of samples becomes a fixed number of channels, in log transfer."""

    channels: int
    encode: Callable[[Samples], Float[Tensor, "n c h w"]]


def encode_single(samples: Samples) -> Float[Tensor, "n 24 h w"]:
    """Slot after slot; MISSING in empty ones."""
    values = log_forward(samples.radiance).where(samples.valid_mask, MISSING)  # n s 3 h w
    empty = SLOTS - values.shape[1]
    return F.pad(values, (0,) * 7 + (empty,), value=MISSING).flatten(1, 2)


def encode_mean(samples: Samples) -> Float[Tensor, "n 3 h w"]:
    """The mean; MISSING in a pixel without samples."""
    return log_forward(samples.mean).where(samples.counts > 0, MISSING)


def encode_nothing(samples: Samples) -> Float[Tensor, "n 0 h w"]:
    """A tensor of zero channels, for variants without an encoder."""
    n, _, _, h, w = samples.radiance.shape
    return samples.radiance.new_empty(n, 0, h, w)


SAMPLE_ENCODINGS: Mapping[str, SampleEncoding] = {
    "single": SampleEncoding(3 * SLOTS, encode_single),
    "mean": SampleEncoding(3, encode_mean),
    "none": SampleEncoding(0, encode_nothing),
}


def history_features(config: Config) -> int:
    """Channels of the features that a variant carries from frame to frame."""
    samples = SAMPLE_ENCODINGS[config.sample_encoding].channels
    return {"state": config.latent, "samples": samples, "nothing": 0}[config.history_mode]


class Sampler(nn.Module):
    """A narrow U-Net from G-buffer and history to one action per pixel, in [-1, 1].

    Scardigli et al. 2023, section 2.3 (first layer: 4 channels); levels and blocks as in the
    authors' release, "big" table, which is the paper's normal size.

    Differs from the paper where it is `paced`: the last input channel is the logarithm of the
    budget, and the value before tanh is multiplied by a power of the budget, whose factor and
    exponent are learned. A map that gains with 4 samples per pixel is too bold with half a sample.
    With a `stride` of 2, it reads means of 2 x 2 pixels, and its actions are
    interpolated: narrow layers at full resolution take long on a processor.
    """

    def __init__(
        self, inputs: int, widths: tuple[int, ...], paced: bool = False, stride: Literal[1, 2] = 1
    ) -> None:
        """Build with `inputs` channels, and `widths` channels at the levels, finest first."""
        super().__init__()
        self.stride = stride
        pairs = list(pairwise(widths))
        self.tail = nn.Conv2d(inputs, widths[0], 3, padding=1)
        self.down = nn.ModuleList(_block(a, b) for a, b in pairs)
        self.pool = nn.MaxPool2d(2)
        self.up = nn.ModuleList(nn.ConvTranspose2d(b, a, 2, stride=2) for a, b in pairs[:0:-1])
        self.merge = nn.ModuleList(_block(2 * a, a) for a, _ in pairs[:0:-1])
        self.head = nn.Conv2d(widths[1], 2, 3, padding=1)
        self.last = nn.Conv2d(2, 1, 3, padding=1)
        self.pace = nn.Parameter(torch.zeros(2)) if paced else None  # log of factor, exponent

    def start_uniform(self) -> None:
        """Zero the last layer, so that every action is zero and the density is constant."""
        nn.init.zeros_(self.last.weight)
        assert self.last.bias is not None
        nn.init.zeros_(self.last.bias)

    def forward(self, inputs: Float[Tensor, "n c h w"]) -> Float[Tensor, "n 1 h w"]:
        """The mean action. With L levels, h and w must be multiples of stride * 2 ** (L - 2)."""
        # at half size, bilinear taps are means of 2 x 2 pixels, and take a quarter of avg_pool2d
        x = F.interpolate(inputs, scale_factor=0.5, mode="bilinear") if self.stride > 1 else inputs
        x = self.tail(to_channels_last(x))
        skips = []
        for depth, block in enumerate(self.down):
            x = block(self.pool(x) if depth else x)
            skips.append(x)
        for up, merge, skip in zip(self.up, self.merge, skips[-2::-1], strict=True):
            x = merge(torch.cat((up(x), skip), dim=1))
        raw = self.last(self.head(x))
        if self.pace is not None:
            raw = raw * (self.pace[0] + self.pace[1] * inputs[:, -1:, :1, :1]).exp()
        if self.stride > 1:
            raw = F.interpolate(raw, scale_factor=2.0, mode="bilinear")
        return torch.tanh(raw)


class Encoder(nn.Module):
    """From samples, G-buffer and history to the new state, bounded by tanh.

    Kernels are 3x3 as in the paper's text. Input channels are those of its memory count and of the
    release: 24 samples, 7 G-buffer, 32 state.
    """

    def __init__(self, inputs: int, hidden: tuple[int, ...], outputs: int, kernel: int) -> None:
        """Build with `inputs` channels, `hidden` channels between, and `outputs` channels."""
        super().__init__()
        widths = pairwise((inputs, *hidden, outputs))
        self.layers = nn.ModuleList(nn.Conv2d(a, b, kernel, padding=kernel // 2) for a, b in widths)

    def forward(self, inputs: Float[Tensor, "n c h w"]) -> Float[Tensor, "n s h w"]:
        """The new state, in [-1, 1]."""
        x = to_channels_last(inputs)
        for layer in self.layers[:-1]:
            x = torch.relu_(layer(x))
        return torch.tanh(self.layers[-1](x))


class Networks(nn.Module):
    """All that is trained and saved for one variant."""

    def __init__(self, config: Config) -> None:
        """Build the networks of `config`, with weights from torch's default generator."""
        super().__init__()
        samples = SAMPLE_ENCODINGS[config.sample_encoding].channels
        history = GBUFFER_CHANNELS + history_features(config)
        history += HISTORY_INPUTS * config.accumulates
        self.sampler_channels = history + config.accumulates  # and the logarithm of the last spp
        self.sampler = None
        if config.sampler:
            self.sampler = Sampler(
                self.sampler_channels, config.sampler, config.accumulates, config.sampler_stride
            )
        self.encoder, latent, written = None, GBUFFER_CHANNELS + samples, 0
        if config.denoiser_writes_latent:
            latent, written = RADIANCE_FEATURES + config.latent, config.latent
            written += config.kernel_taps and 1 + config.kernel_taps  # a gate and the weights
        if config.encoder:
            # one channel more: how far accumulated radiance is trusted
            outputs = config.latent + config.accumulates
            self.encoder = Encoder(
                history + samples, config.encoder, outputs, config.encoder_kernel
            )
            latent = config.latent
        radiance = 0 if config.accumulation == "none" else DENOISER_INPUTS
        # one channel more: how far the previous image is kept
        outputs = 3 + config.accumulates + written
        self.denoiser = UNet(radiance + latent, outputs, config.denoiser)


def _block(inputs: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, 3, padding=1),
        nn.ReLU(inplace=True),
        nn.Conv2d(outputs, outputs, 3, padding=1),
    )
