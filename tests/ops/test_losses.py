"""Training losses against other libraries, closed forms and loops."""

from __future__ import annotations

import math

import kornia
import pytest
import pytorch_msssim
import torch
from skimage.metrics import peak_signal_noise_ratio as skimage_psnr

from rlbench.ops.color import encode_srgb
from rlbench.ops.losses import (
    MS_SSIM_WEIGHTS,
    UNIFORM_WEIGHTS,
    display_mse,
    l1_ms_ssim_loss,
    log_loss,
    log_transfer_loss,
    ms_ssim,
    smape,
    temporal_l1,
)
from rlbench.ops.transfer import log_inverse


def pair(h: int, w: int, noise: float = 0.1, n: int = 2) -> tuple[torch.Tensor, torch.Tensor]:
    """A smooth image and a noisy one."""
    generator = torch.Generator().manual_seed(h * 1000 + w)
    x = torch.linspace(0, 9, w).sin() * torch.linspace(0, 7, h).cos()[:, None]
    reference = (0.5 + 0.4 * x).expand(n, 3, h, w)
    gaussian = torch.randn(n, 3, h, w, generator=generator)
    return (reference + noise * gaussian).clamp(0, 1), reference


def slow_ms_ssim(x: torch.Tensor, y: torch.Tensor, weights: tuple[float, ...]) -> float:
    """One channel [h w], in float64, window by window, by the formula of the paper."""
    x, y = x.double(), y.double()
    at = torch.arange(11, dtype=torch.float64) - 5
    window = torch.exp(-(at[:, None] ** 2 + at**2) / 4.5)
    window /= window.sum()
    product = 1.0
    for scale, weight in enumerate(weights):
        if scale:
            x, y = (z.unflatten(0, (-1, 2)).unflatten(2, (-1, 2)).mean((1, 3)) for z in (x, y))
        contrasts, products = [], []
        for i in range(x.shape[0] - 10):
            for j in range(x.shape[1] - 10):
                a, b = x[i : i + 11, j : j + 11], y[i : i + 11, j : j + 11]
                ma, mb = (window * a).sum(), (window * b).sum()
                va, vb = (window * (a - ma) ** 2).sum(), (window * (b - mb) ** 2).sum()
                cov = (window * (a - ma) * (b - mb)).sum()
                contrast = (2 * cov + 9e-4) / (va + vb + 9e-4)
                contrasts.append(contrast)
                products.append(contrast * (2 * ma * mb + 1e-4) / (ma**2 + mb**2 + 1e-4))
        terms = products if scale == len(weights) - 1 else contrasts
        product *= max(0.0, float(torch.stack(terms).mean())) ** weight
    return product


@pytest.mark.parametrize("size", [(176, 176), (163, 201)])
@pytest.mark.parametrize("weights", [MS_SSIM_WEIGHTS, UNIFORM_WEIGHTS])
def test_ms_ssim_equals_pytorch_msssim(size, weights):
    x, y = pair(*size)
    theirs = pytorch_msssim.ms_ssim(
        x, y, data_range=1, size_average=False, weights=[w / sum(weights) for w in weights]
    )
    # float32 moments of values up to 1 against C2 = 9e-4
    torch.testing.assert_close(ms_ssim(x, y, weights), theirs, atol=1e-5, rtol=0)


def test_ms_ssim_of_one_scale_equals_ssim_of_kornia():
    x, y = pair(21, 30)
    theirs = kornia.metrics.ssim(x, y, 11, padding="valid").mean((1, 2, 3))
    # float32, kornia subtracts squares of means of order 1 from one another
    torch.testing.assert_close(ms_ssim(x, y, (1.0,)), theirs, atol=1e-4, rtol=0)


def test_ms_ssim_of_two_scales_equals_the_formula_of_the_paper():
    x, y = pair(24, 32, n=1)
    weights = tuple(weight / sum(MS_SSIM_WEIGHTS[:2]) for weight in MS_SSIM_WEIGHTS[:2])
    slow = sum(slow_ms_ssim(x[0, c], y[0, c], weights) for c in range(3)) / 3
    assert float(ms_ssim(x, y)) == pytest.approx(slow, abs=1e-5)  # float32 against float64


@pytest.mark.parametrize(
    ("side", "scales"), [(11, 1), (20, 1), (21, 2), (22, 2), (128, 4), (160, 4), (161, 5), (400, 5)]
)
def test_ms_ssim_uses_the_scales_that_fit(side, scales):
    x, y = pair(side, side + 3, n=1)
    fitting = tuple(w / sum(MS_SSIM_WEIGHTS[:scales]) for w in MS_SSIM_WEIGHTS[:scales])
    torch.testing.assert_close(ms_ssim(x, y), ms_ssim(x, y, fitting))


def test_an_image_smaller_than_the_window_is_an_error():
    with pytest.raises(ValueError, match=r"at least 11 pixels, got \[10, 40\]"):
        ms_ssim(*pair(10, 40))


@pytest.mark.parametrize(("a", "b"), [(0.0, 0.5), (0.2, 0.8), (1e3, 0.0)])
def test_ms_ssim_of_constant_images_is_their_luminance_term(a, b):
    x, y = torch.full((1, 3, 16, 16), a), torch.full((1, 3, 16, 16), b)
    expected = (2 * a * b + 1e-4) / (a * a + b * b + 1e-4)
    # the variance of a constant image is float32 rounding of its square, against C2 = 9e-4
    assert float(ms_ssim(x, y)) == pytest.approx(expected, abs=1e-3)


def test_the_gradient_of_ms_ssim_equals_that_of_pytorch_msssim():
    x, y = pair(176, 176, n=1)
    mine, theirs = (x.clone().requires_grad_() for _ in range(2))
    ms_ssim(mine, y).mean().backward()
    pytorch_msssim.ms_ssim(theirs, y, data_range=1).backward()
    # MS_SSIM_WEIGHTS sums to 1.0001 and is rescaled here; float32 as above
    tolerance = 1e-3 * float(theirs.grad.abs().max())
    torch.testing.assert_close(mine.grad, theirs.grad, atol=tolerance, rtol=0)


@pytest.mark.parametrize("sign", [1, -1])
def test_gradients_of_the_mixed_loss_are_finite(sign):
    """Also for the negative of the reference, whose similarity counts as zero."""
    x, y = pair(48, 48)
    x = (0.5 + sign * (x - 0.5)).requires_grad_()
    l1_ms_ssim_loss(x, y).backward()
    assert torch.isfinite(x.grad).all()
    assert x.grad.any()


def test_the_mixed_loss_is_16_percent_l1_and_84_percent_dissimilarity():
    x, y = pair(32, 40)
    expected = 0.16 * (x - y).abs().mean() + 0.84 * (1 - ms_ssim(x, y).mean())
    plain = l1_ms_ssim_loss(x, y)
    torch.testing.assert_close(plain, expected)
    with torch.autocast("cpu", torch.bfloat16):
        assert torch.equal(l1_ms_ssim_loss(x, y), plain)


@pytest.mark.parametrize("scale", [1.0, 1e4])
def test_smape_equals_a_loop(scale):
    x, y = (scale * z[:1, :, :4, :5] for z in pair(16, 16))
    terms = [
        abs(a - b) / (abs(a) + abs(b) + 0.01)
        for a, b in zip(x.flatten().tolist(), y.flatten().tolist(), strict=True)
    ]
    assert float(smape(x, y)) == pytest.approx(math.fsum(terms) / len(terms), rel=1e-5)


def test_temporal_l1_measures_flicker_against_a_static_reference():
    x, y = pair(16, 16)
    assert float(temporal_l1(x + 0.1, x - 0.1, y, y)) == pytest.approx(0.2, rel=1e-5)
    assert float(temporal_l1(x + 0.3, x + 0.1, y + 0.2, y)) < 1e-6  # a constant error is none


@pytest.mark.parametrize("value", [0.5, 0.02, 1e-4])
def test_log_loss_depends_on_relative_changes_alone(value):
    loss = torch.tensor(value, requires_grad=True)
    decrease = log_loss(loss) - log_loss(0.9 * loss)
    assert decrease.item() == pytest.approx(-0.02 * math.log(0.9), rel=1e-4)
    log_loss(loss).backward()
    assert float(loss.grad) == pytest.approx(0.02 / value)
    perfect = torch.tensor(0.0, requires_grad=True)
    log_loss(perfect).backward()
    assert float(perfect.grad) == 0


def test_the_display_error_is_that_of_psnr_on_displayable_images():
    torch.manual_seed(0)
    image, reference = torch.rand(2, 1, 3, 8, 9)
    psnr = skimage_psnr(encode_srgb(reference).numpy(), encode_srgb(image).numpy(), data_range=1.0)
    assert -10 * display_mse(image, reference).log10().item() == pytest.approx(psnr, abs=1e-4)


def test_radiance_above_white_is_no_error_where_the_reference_is_white():
    reference = torch.tensor([1.0, 5.0, 0.5]).view(1, 3, 1, 1)
    image = torch.tensor([7.0, 1.0, 2.0]).view(1, 3, 1, 1).requires_grad_()
    display_mse(image, reference).backward()
    assert (image.grad.flatten() != 0).tolist() == [False, False, True]


def test_the_loss_in_log_transfer_is_finite_where_a_network_writes_far_below_zero():
    """log_inverse(-100) is -1/64, whose logarithm is not finite; other pixels keep learning."""
    value = torch.full((1, 3, 32, 32), 0.5)
    value[..., :4] = -100.0
    value.requires_grad_()
    loss = log_transfer_loss(log_inverse(value), torch.full((1, 3, 32, 32), 0.3))
    loss.backward()
    assert loss.isfinite()
    assert value.grad.isfinite().all()
    assert value.grad[..., 20:].abs().sum() > 0
