"""The network that learns online: its weights are numbers in the state, one set for each clip."""

from __future__ import annotations

from itertools import accumulate, pairwise
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional as F

from rlbench.ops.padding import crop, pad

INPUTS, OUTPUTS = 15, 6  # both pilots, last output, albedo, normal; five bandwidths and alpha
LAYERS = (  # channels in, channels out, side of the kernel
    *((INPUTS, 8, 3), (8, 8, 3), (8, 16, 3), (16, 16, 3), (16, 32, 3), (32, 32, 3)),
    *((32, 32, 1), (48, 16, 3), (16, 16, 3), (16, 16, 1), (24, 8, 3), (8, OUTPUTS, 1)),
)
SIZES = [before * after * side**2 + after for before, after, side in LAYERS]
PARAMETERS = sum(SIZES)
PLACES = list(pairwise(accumulate(SIZES, initial=0)))  # of each layer among the weights
BAND_OFFSET = 1e-4  # bandwidths become 1 / (output^2 + this)
DECAY_MEAN, DECAY_SQUARE, ADAM_EPS = 0.9, 0.999, 1e-7  # of Adam, as in Keras


class Learner(NamedTuple):
    """Weights of the network and moments of Adam (Kingma and Ba 2015), for each clip."""

    weights: Float[Tensor, "n p"]
    mean: Float[Tensor, "n p"]  # of gradients
    square: Float[Tensor, "n p"]  # mean of squared gradients
    steps: Float[Tensor, "n 1"]

    @classmethod
    def begin(cls, weights: Float[Tensor, " p"], n: int) -> Learner:
        """Learners of n clips that have made no step."""
        rows = weights.expand(n, -1).clone()
        return cls(
            rows, torch.zeros_like(rows), torch.zeros_like(rows), torch.zeros_like(rows[:, :1])
        )

    def step(self, gradient: Float[Tensor, "n p"], rate: float) -> Learner:
        """The learners after a step of Adam; one whose gradient is not finite makes none."""
        gradient = gradient.where(gradient.isfinite().all(1, keepdim=True), 0.0)
        steps = self.steps + 1
        mean = torch.lerp(gradient, self.mean, DECAY_MEAN)
        square = torch.lerp(gradient.square(), self.square, DECAY_SQUARE)
        unbiased_mean = mean / (1 - DECAY_MEAN**steps)
        unbiased_square = square / (1 - DECAY_SQUARE**steps)
        weights = self.weights - rate * unbiased_mean / (unbiased_square.sqrt() + ADAM_EPS)
        return Learner(weights, mean, square, steps)


def random_weights(seed: int) -> Float[Tensor, " p"]:
    """Uniform weights of Glorot and Bengio 2010, and zero biases, as is the default in Keras."""
    generator = torch.Generator().manual_seed(seed)
    parts = []
    for before, after, side in LAYERS:
        kernel = torch.empty(after, before, side, side)
        nn.init.xavier_uniform_(kernel, generator=generator)
        parts += [kernel.flatten(), torch.zeros(after)]
    return torch.cat(parts)


def predict(
    weights: Float[Tensor, "n p"], inputs: Float[Tensor, "n 15 h w"]
) -> tuple[Float[Tensor, "n 5 h w"], Float[Tensor, "n 1 h w"]]:
    """Bandwidths, and alpha in (0, 1), the weight of the new frame; of any size."""
    h, w = inputs.shape[2:]
    layers = iter(zip(LAYERS, PLACES, strict=True))

    def convolve(x: Tensor, is_last: bool = False) -> Tensor:
        shape, place = next(layers)
        x = _convolve(x, weights[:, slice(*place)], shape)
        return x if is_last else x.relu()

    def upsample(x: Tensor) -> Tensor:
        shape, place = next(layers)
        return _upsample(x, weights[:, slice(*place)], shape)

    fine = convolve(convolve(pad(inputs, 4)))
    middle = convolve(convolve(F.max_pool2d(fine, 2)))
    coarse = convolve(convolve(F.max_pool2d(middle, 2)))
    middle = convolve(convolve(torch.cat((upsample(coarse), middle), 1)))
    output = convolve(convolve(torch.cat((upsample(middle), fine), 1)), is_last=True)
    bands, alpha = crop(output, h, w).split_with_sizes((OUTPUTS - 1, 1), 1)
    return 1 / (bands.square() + BAND_OFFSET), alpha.sigmoid()


def _convolve(x: Tensor, weights: Float[Tensor, "n q"], shape: tuple[int, int, int]) -> Tensor:
    """A convolution in which each image has a kernel of its own."""
    n, (before, after, side) = len(x), shape
    kernel, bias = weights[:, :-after], weights[:, -after:]
    kernel = kernel.reshape(n * after, before, side, side)
    joined = x.reshape(1, n * before, *x.shape[2:])
    result = F.conv2d(joined, kernel, bias.reshape(-1), padding=side // 2, groups=n)
    return result.view(n, after, *x.shape[2:])


def _upsample(x: Tensor, weights: Float[Tensor, "n q"], shape: tuple[int, int, int]) -> Tensor:
    """Twice the size: a kernel of one pixel and a step of two; other pixels get the bias."""
    n, (before, after, _) = len(x), shape
    kernel, bias = weights[:, :-after], weights[:, -after:]
    kernel = kernel.reshape(n, after, before).transpose(1, 2).reshape(n * before, after, 1, 1)
    joined = x.reshape(1, n * before, *x.shape[2:])
    result = F.conv_transpose2d(
        joined, kernel, bias.reshape(-1), stride=2, output_padding=1, groups=n
    )
    return result.view(n, after, 2 * x.shape[2], 2 * x.shape[3])
