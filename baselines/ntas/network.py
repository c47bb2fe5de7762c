"""NTAS's two networks: a sampler for the density, a denoiser that predicts kernels."""

from __future__ import annotations

import math
from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional as F

from rlbench.ops.box_filter import block_mean
from rlbench.ops.init import kaiming_init
from rlbench.ops.kernels import apply_kernels
from rlbench.ops.padding import crop, pad
from rlbench.ops.transfer import HALF_MAX, LOG_SCALE, log_inverse
from rlbench.ops.unet import STRIDE, FeatureUNet, UNet
from rlbench.ops.unet_widths import BASE_WIDTHS

GBUFFER_CHANNELS = 7  # normal, albedo, depth
COLOUR_CHANNELS = 3
TAPS = 25  # 5 x 5
COARSEST_LEVEL = 4  # halvings of the coarsest filtered level
LAST_LAYER_GAIN = 0.1  # of the last layers' initial weights, times He's
OUTPUT_OFFSET = 0.5  # log_forward of irradiance 0.11
# log_forward of the largest half float
MAX_LOG = math.log1p(LOG_SCALE * HALF_MAX) / math.log1p(LOG_SCALE)
MAX_LOG_WEIGHT = 30.0  # other weights vanish beside a larger one in float32


class Networks(nn.Module):
    """Sampler and denoiser, trained and stored together."""

    def __init__(self, denoiser: Callable[[], Denoiser | DirectDenoiser] | None = None) -> None:
        """`denoiser` makes the second network; `init_weights` draws seeded weights."""
        super().__init__()
        self.sampler = Sampler()
        self.denoiser = (denoiser or Denoiser)()

    def init_weights(self, seed: int) -> None:
        """Draw seeded weights; small last layers start density and kernels near uniform."""
        kaiming_init(self, seed)
        for layer in (self.sampler.unet.dec_conv0, *self.denoiser.last_layers):
            for weight in layer.parameters():
                weight.data.mul_(LAST_LAYER_GAIN)


class Sampler(nn.Module):
    """A U-Net from the G-buffer and the previous image to the log density."""

    def __init__(self) -> None:
        """From 10 channels to 1."""
        super().__init__()
        self.unet = UNet(GBUFFER_CHANNELS + COLOUR_CHANNELS, 1)

    def forward(self, features: Float[Tensor, "n 10 h w"]) -> Float[Tensor, "n 1 h w"]:
        """The logarithm of the density, up to a constant; any image size."""
        log_density = self.unet(pad(features, STRIDE)).float()
        return crop(log_density, *features.shape[-2:])


class Denoiser(nn.Module):
    """Predicted kernels on a pyramid of the noisy irradiance and on the reprojected history.

    Level l = 0 .. 4 holds the irradiance averaged over 2^l x 2^l pixels, and F_l is that level
    filtered by one softmax kernel of 5 x 5 taps per pixel. Then O_4 = F_4 and
    O_l = a_l F_l + (1 - a_l) up(O_{l+1}), with a sigmoid a_l and bilinear upsampling. At l = 0 the
    softmax runs over 25 taps of the irradiance and 25 of the history, times their weight. The
    output is therefore a weighted mean of the input: never negative, never brighter.

    Hierarchical kernels and warped feedback are those of Hasselgren et al. 2020; more of the paper
    could not be confirmed. Ours, and possibly different: the trunk, the five levels, the 5 x 5
    taps, the blend, the 1 x 1 heads (3 x 3 at l = 0, the U-Net's own last layer), and the coarsest
    head, which reads the features of level 3 averaged over 2 x 2.
    """

    traceable = False  # kernels are applied by an operation of our own

    def __init__(self) -> None:
        """A trunk that takes 13 channels, and a head at each level."""
        super().__init__()
        self.unet = FeatureUNet(COLOUR_CHANNELS + GBUFFER_CHANNELS + COLOUR_CHANNELS, 2 * TAPS + 1)
        widths = BASE_WIDTHS.dec4[1], BASE_WIDTHS.dec3[1], BASE_WIDTHS.dec2[1]
        self.coarsest = nn.Conv2d(widths[0], TAPS, 1)
        self.heads = nn.ModuleList(nn.Conv2d(width, TAPS + 1, 1) for width in widths)

    @property
    def last_layers(self) -> list[nn.Module]:
        """The layers that return kernels and blend weights, coarse to fine."""
        return [self.coarsest, *self.heads, self.unet.dec_conv0]

    def forward(
        self,
        features: Float[Tensor, "n 13 h w"],
        irradiance: Float[Tensor, "n 3 h w"],
        history: Float[Tensor, "n 3 h w"],
        weight: Float[Tensor, "n 1 h w"],
    ) -> Float[Tensor, "n 3 h w"]:
        """Filtered irradiance, linear.

        `weight`, in [0, 1], multiplies the kernels' weights of the history. The history must be
        finite everywhere, even where its weight is 0.
        """
        *coarse, finest = self.unet(pad(features, STRIDE))
        pyramid = [pad(irradiance, STRIDE)]
        for _ in range(COARSEST_LEVEL):
            pyramid.append(block_mean(pyramid[-1], 2))

        kernels = self.coarsest(F.avg_pool2d(coarse[0], 2)).float().softmax(1)
        output: Tensor = apply_kernels(kernels, pyramid[COARSEST_LEVEL])
        for head, level_features, level in zip(self.heads, coarse, pyramid[3:0:-1], strict=True):
            logits, blend = head(level_features).float().split_with_sizes((TAPS, 1), 1)
            output = _blend(apply_kernels(logits.softmax(1), level), output, blend)

        logits, history_logits, blend = (
            self.unet.dec_conv0(finest).float().split_with_sizes((TAPS, TAPS, 1), 1)
        )
        weighted = pad(torch.cat((history * weight, weight), 1), STRIDE)
        finest_level = _filter_with_history(logits, history_logits, pyramid[0], weighted)
        return crop(_blend(finest_level, output, blend), *irradiance.shape[-2:])


class DirectDenoiser(nn.Module):
    """A U-Net from the inputs of `Denoiser` to the irradiance itself, without kernels.

    In the release of Scardigli et al. 2023 a U-Net predicts colours instead of kernels:
    convolutions of 48 to 96 channels, six poolings, two last layers without padding, and a ReLU on
    the output, at half resolution, upsampled to 2 x 2 pixels and cropped. Differs from it: the
    U-Net is the one that predicts the density and the kernels here, so that the outputs alone
    differ; its output has full resolution and is `log_forward(irradiance)`, demodulated, where
    theirs is display colour. Ours: 0.5 is added to the output, so that no colour starts where the
    ReLU has no gradient.
    """

    def __init__(self) -> None:
        """From 13 channels to 3."""
        super().__init__()
        self.unet = UNet(COLOUR_CHANNELS + GBUFFER_CHANNELS + COLOUR_CHANNELS, COLOUR_CHANNELS)

    @property
    def last_layers(self) -> list[nn.Module]:
        """The layer that returns colours."""
        return [self.unet.dec_conv0]

    def forward(
        self,
        features: Float[Tensor, "n 13 h w"],
        irradiance: Float[Tensor, "n 3 h w"],
        history: Float[Tensor, "n 3 h w"],
        weight: Float[Tensor, "n 1 h w"],
    ) -> Float[Tensor, "n 3 h w"]:
        """Irradiance, linear, in [0, 65504]; samples and history enter through `features` alone."""
        output = self.unet(pad(features, STRIDE)).float() + OUTPUT_OFFSET
        return log_inverse(crop(output, *irradiance.shape[-2:]).clamp(0, MAX_LOG))


def _filter_with_history(
    logits: Float[Tensor, "n taps h w"],
    history_logits: Float[Tensor, "n taps h w"],
    irradiance: Float[Tensor, "n 3 h w"],
    weighted: Float[Tensor, "n 4 h w"],
) -> Float[Tensor, "n 3 h w"]:
    """Joint softmax over the taps of irradiance and history.

    `weighted` holds the history times its weight, and that weight, in [0, 1].
    """
    largest = logits.detach().amax(1, keepdim=True)
    weights = (logits - largest).exp()
    history_weights = (history_logits - largest).clamp_max(MAX_LOG_WEIGHT).exp()
    history_sum, history_weight = apply_kernels(history_weights, weighted).split_with_sizes(
        (COLOUR_CHANNELS, 1), 1
    )
    total = weights.sum(1, keepdim=True) + history_weight  # >= 1, by the largest of `logits`
    return (apply_kernels(weights, irradiance) + history_sum) / total


def _blend(fine: Tensor, coarse: Tensor, logit: Tensor) -> Tensor:
    """sigmoid(logit) of the finer level plus the rest of the upsampled coarser level."""
    upsampled = F.interpolate(coarse, scale_factor=2.0, mode="bilinear", align_corners=False)
    return torch.lerp(upsampled, fine, logit.sigmoid())
