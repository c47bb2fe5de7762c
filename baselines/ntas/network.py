"""The two networks: one draws the map of samples, one predicts a hierarchy of kernels."""

from __future__ import annotations

import math
from collections.abc import Callable

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn
from torch.nn import functional as F

from rlbench.ops.init import kaiming_init
from rlbench.ops.kernels import apply_kernels
from rlbench.ops.padding import crop, pad
from rlbench.ops.transfer import HALF_MAX, LOG_SCALE, log_inverse
from rlbench.ops.unet import BASE_WIDTHS, STRIDE, UNet

VIEW = 7  # normal, albedo, depth
COLOUR = 3
TAPS = 25  # 5x5
COARSEST = 4  # halvings of the coarsest level that is filtered
FAINT = 0.1  # share of He's weights that the last layers start with
MIDDLE = 0.5  # log_forward of light of 0.11
BRIGHTEST = math.log1p(LOG_SCALE * HALF_MAX) / math.log1p(
    LOG_SCALE
)  # log_forward of the largest half
SATURATED = 30.0  # a log weight above this one leaves nothing of the others in float32


class Networks(nn.Module):
    """Sampler and denoiser, trained and stored together."""

    def __init__(self, denoiser: Callable[[], Denoiser | Direct] | None = None) -> None:
        """Weights are the U-Net's; for seeded ones see `draw`. `denoiser` makes the second one."""
        super().__init__()
        self.sampler = Sampler()
        self.denoiser = (denoiser or Denoiser)()

    def draw(self, seed: int) -> None:
        """Seeded weights, faint in the last layers: map and kernels start near uniform."""
        kaiming_init(self, seed)
        for layer in (self.sampler.unet.dec_conv0, *self.denoiser.last_layers()):
            for weight in layer.parameters():
                weight.data.mul_(FAINT)


class Sampler(nn.Module):
    """The map of samples: a U-Net from the view and the last image to one number a pixel."""

    def __init__(self) -> None:
        """10 channels in, 1 out."""
        super().__init__()
        self.unet = UNet(VIEW + COLOUR, 1)

    def forward(self, seen: Float[Tensor, "n 10 h w"]) -> Float[Tensor, "n 1 h w"]:
        """The logarithm of the density, up to a constant; any size."""
        wish = self.unet(pad(seen, STRIDE)).float()
        return crop(wish, *seen.shape[-2:])


class Denoiser(nn.Module):
    """Kernels on a pyramid of the noisy light, blended from coarse to fine, and on the history.

    Level l holds the light averaged over squares of 2^l pixels, l = 0 .. 4, and F_l is it filtered
    by softmax kernels of 5x5 taps, one for each pixel. Then O_4 = F_4 and
    O_l = a_l F_l + (1 - a_l) up(O_{l+1}), a_l a sigmoid, up bilinear. At l = 0 the softmax runs
    over 25 taps of the light and 25 of the history, without those where history is not valid.
    The light that comes out is thus a mean of what came in: never negative, never above it.

    Kernels in a hierarchy and warped feedback are those of Hasselgren et al. 2020; more of the
    paper could not be confirmed. What follows is ours and may differ: the trunk, the five levels,
    the 5x5 taps, the blend, heads of 1x1 (3x3 at l = 0, the U-Net's own last layer), and the
    coarsest head, which sees the features of level 3 averaged over 2x2.
    """

    def __init__(self) -> None:
        """13 channels into the trunk, a head at each level."""
        super().__init__()
        self.unet = UNet(COLOUR + VIEW + COLOUR, 2 * TAPS + 1)
        widths = BASE_WIDTHS.dec4[1], BASE_WIDTHS.dec3[1], BASE_WIDTHS.dec2[1]
        self.coarsest = nn.Conv2d(widths[0], TAPS, 1)
        self.heads = nn.ModuleList(nn.Conv2d(width, TAPS + 1, 1) for width in widths)

    def last_layers(self) -> list[nn.Module]:
        """The layers that kernels and blends come from, coarse to fine."""
        return [self.coarsest, *self.heads, self.unet.dec_conv0]

    def forward(
        self,
        seen: Float[Tensor, "n 13 h w"],
        light: Float[Tensor, "n 3 h w"],
        history: Float[Tensor, "n 3 h w"],
        valid: Bool[Tensor, "n 1 h w"],
    ) -> Float[Tensor, "n 3 h w"]:
        """Filtered light, linear as `light` and `history` are; history is finite everywhere."""
        *coarse, finest = self.unet.decoder_features(pad(seen, STRIDE))
        pyramid = [pad(light, STRIDE)]
        for _ in range(COARSEST):
            pyramid.append(F.avg_pool2d(pyramid[-1], 2))

        kernels = self.coarsest(F.avg_pool2d(coarse[0], 2)).float().softmax(1)
        output: Tensor = apply_kernels(kernels, pyramid[COARSEST])
        for head, features, level in zip(self.heads, coarse, pyramid[3:0:-1], strict=True):
            taps, share = head(features).float().split_with_sizes((TAPS, 1), 1)
            output = _blend(apply_kernels(taps.softmax(1), level), output, share)

        taps, past_taps, share = (
            self.unet.dec_conv0(finest).float().split_with_sizes((TAPS, TAPS, 1), 1)
        )
        past = pad(torch.cat((history * valid, valid.to(history.dtype)), 1), STRIDE)
        output = _blend(_filter(taps, past_taps, pyramid[0], past), output, share)
        return crop(output, *light.shape[-2:])


class Direct(nn.Module):
    """A U-Net from what `Denoiser` sees to the light itself, colour by colour, without kernels.

    In place of kernels Scardigli et al. 2023 have a U-Net that says colours, in their release:
    convolutions of 48 to 96 channels, six poolings, two layers without padding at the end, a ReLU
    on what it says, at half resolution, enlarged to 2x2 pixels and cropped. Differs from it: the
    U-Net is that of the sampler and of the kernels here, so that only what is said differs;
    it speaks at full resolution; what it says is `log_forward(light)`, where theirs are colours
    of the display, and light is free of albedo. Ours: it says how far light is from 0.5 in log
    transfer, so that no colour starts where the ReLU has no slope.
    """

    def __init__(self) -> None:
        """13 channels in, 3 out."""
        super().__init__()
        self.unet = UNet(COLOUR + VIEW + COLOUR, COLOUR)

    def last_layers(self) -> list[nn.Module]:
        """The layer that colours come from."""
        return [self.unet.dec_conv0]

    def forward(
        self,
        seen: Float[Tensor, "n 13 h w"],
        light: Float[Tensor, "n 3 h w"],
        history: Float[Tensor, "n 3 h w"],
        valid: Bool[Tensor, "n 1 h w"],
    ) -> Float[Tensor, "n 3 h w"]:
        """Light, linear, in [0, 65504]; samples and history enter by `seen` alone."""
        said = self.unet(pad(seen, STRIDE)).float() + MIDDLE
        return log_inverse(crop(said, *light.shape[-2:]).clamp(0, BRIGHTEST))


def _filter(
    taps: Float[Tensor, "n taps h w"],
    past_taps: Float[Tensor, "n taps h w"],
    light: Float[Tensor, "n 3 h w"],
    past: Float[Tensor, "n 4 h w"],
) -> Float[Tensor, "n 3 h w"]:
    """Softmax over the taps of light and history jointly; `past` is history and its validity."""
    top = taps.detach().amax(1, keepdim=True)
    weights = (taps - top).exp()
    past_weights = (past_taps - top).clamp_max(SATURATED).exp()
    remembered, trust = apply_kernels(past_weights, past).split_with_sizes((COLOUR, 1), 1)
    total = weights.sum(1, keepdim=True) + trust  # >= 1, from the largest of `taps`
    return (apply_kernels(weights, light) + remembered) / total


def _blend(fine: Tensor, coarse: Tensor, share: Tensor) -> Tensor:
    """The finer level and the coarser one, brought to its size, in the proportion of a sigmoid."""
    raised = F.interpolate(coarse, scale_factor=2.0, mode="bilinear", align_corners=False)
    return torch.lerp(raised, fine, share.sigmoid())
