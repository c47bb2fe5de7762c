"""The metric catalogue: one score per image of a batch, in the declared direction."""

from __future__ import annotations

from functools import partial

import pytest
import torch

from metrics import catalog, catalog_video
from metrics.catalog import MS_SSIM, PSNR, SSIM

ALL = [getattr(module, name) for module in (catalog, catalog_video) for name in module.__all__]
METRICS = [metric for metric in ALL if not metric.whole_clip]
DIRECTED = [metric for metric in METRICS if metric.direction and not metric.scores_previous]
SIZE = (2, 3, 165, 170)


def reference_halves(seed=3):
    """Both halves of a reference, with noise of 0.02 of display white."""
    g = torch.Generator().manual_seed(seed)
    truth = torch.rand(SIZE, generator=g)
    return tuple(truth + 0.02 * torch.randn(SIZE, generator=g) for _ in "ab")


def score(metric, image, a, b):
    """The score of a frame with counts from 0 to 8, after two in which the image was right."""
    right = partial(metric.compare, (a + b) / 2, a, b, static=True)
    counts = (
        torch.arange(image[:1, :1].numel())
        .view(1, 1, *image.shape[2:])
        .expand(len(image), -1, -1, -1)
    )
    frame = metric.compare(
        image, a, b, counts=counts % 9, max_samples=8, static=True, previous=right(previous=right())
    )
    return metric.score(frame)


@pytest.mark.parametrize("metric", METRICS, ids=lambda m: m.name)
def test_images_of_a_batch_are_scored_independently(metric):
    a, b = reference_halves()
    image = torch.stack([a[0] + 0.2, b[1]])
    single = [score(metric, image[i : i + 1], a[i : i + 1], b[i : i + 1]) for i in (0, 1)]
    torch.testing.assert_close(score(metric, image, a, b), torch.cat(single), atol=1e-6, rtol=1e-5)


@pytest.mark.parametrize("metric", DIRECTED, ids=lambda m: m.name)
def test_a_degraded_image_scores_worse_in_the_declared_direction(metric):
    a, b = reference_halves()
    good, bad = (a + b) / 2, (a + b) / 2
    bad[..., :80, :] += 0.3 * torch.rand(
        bad[..., :80, :].shape, generator=torch.Generator().manual_seed(4)
    )
    bad[..., 7, 7] = torch.nan
    sign = {"higher": 1, "lower": -1}[metric.direction]
    assert (sign * score(metric, good, a, b) > sign * score(metric, bad, a, b)).all()


@pytest.mark.parametrize("metric", METRICS, ids=lambda m: m.name)
def test_scores_are_finite_for_any_image(metric):
    """In one batch, whose images are scored independently."""
    (a, b), values = reference_halves(), torch.tensor([0.0, 3e38, torch.nan])
    image = values.view(3, 1, 1, 1).expand(3, *SIZE[1:])
    halves = (half[:1].expand_as(image) for half in (a, b))
    assert torch.isfinite(score(metric, image, *halves)).all()


def test_every_metric_states_its_convention_and_its_source():
    assert [m.name for m in METRICS if len(m.convention) <= 10 or not m.source] == []


@pytest.mark.parametrize(
    ("size", "name"),
    [
        ((1080, 1920), "ms_ssim"),
        ((161, 161), "ms_ssim"),
        ((96, 128), "ms_ssim_4"),
        ((64, 99), "ms_ssim_3"),
        ((11, 99), "ms_ssim_1"),
    ],
)
def test_ms_ssim_with_fewer_scales_has_another_name(size, name):
    assert MS_SSIM.at(*size).name == name


def test_ms_ssim_with_fewer_scales_scores_a_small_image():
    image = torch.rand(1, 3, 64, 96)
    found = score(MS_SSIM.at(64, 96), image, image, image)
    torch.testing.assert_close(found, torch.ones(1), atol=1e-5, rtol=0)  # float32 rounding


@pytest.mark.parametrize("generic", [SSIM, MS_SSIM, SSIM.under("hable")], ids=lambda m: m.name)
def test_similarity_is_nan_below_its_window_size(generic):
    image = torch.rand(2, 3, 10, 96)
    metric = generic.at(10, 96)
    assert score(metric, image, image, image).isnan().tolist() == [True, True]
    assert "below 11 pixels" in generic.at(10, 96).convention or "@" in metric.name


def test_a_metric_defined_at_any_size_needs_no_substitute():
    assert PSNR.at(3, 3) is PSNR
