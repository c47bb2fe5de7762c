"""Images for the tests of metrics."""

from __future__ import annotations

import torch
from skimage.metrics import structural_similarity

from metrics.conventions import SRGB
from metrics.metric import Comparison


def image_pair(h, w, noise=0.3, seed=0, n=2):
    """Image and reference [n 3 h w]: blocks, some above white, and noise on the image."""
    g = torch.Generator().manual_seed(seed)
    blocks = torch.rand(n, 3, h // 7 + 1, w // 7 + 1, generator=g) ** 3 * 2
    reference = blocks.repeat_interleave(7, 2).repeat_interleave(7, 3)[..., :h, :w]
    return reference * (1 + noise * torch.randn(n, 3, h, w, generator=g)), reference


def frame_of(image, reference):
    """A comparison whose reference has no noise."""
    return Comparison.of(image, reference, reference)


def encoded_pair(*size, convention=SRGB, **options):
    """The images of `image_pair` as a convention shows them."""
    return frame_of(*image_pair(*size, **options)).encode(convention)


def skimage_ssim(x, y, **options):
    """SSIM by scikit-image, with the window of Wang et al. 2004, of images in [0, 1]."""
    window = {"gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False}
    return structural_similarity(x, y, data_range=1.0, **window, **options)
