"""Tensor operations for methods: reprojection, demodulation, transfer functions, kernels, U-Net.

    >>> import torch
    >>> from rlbench.ops import UNet, crop, log_forward, pad
    >>> noisy = torch.rand(1, 3, 45, 77)
    >>> network = UNet(in_channels=3)
    >>> crop(network(pad(log_forward(noisy), 16)), 45, 77).shape
    torch.Size([1, 3, 45, 77])

Images are [n c h w]; radiance is linear. Names are imported when they are first used, so that
`import rlbench.ops` alone does not load torch. The stub beside this file lists them.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
