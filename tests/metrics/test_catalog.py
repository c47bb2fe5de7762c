"""The metric catalogue: one score per image of a batch, in the declared direction."""

from __future__ import annotations

import math
from functools import partial
from pathlib import Path

import pytest
import torch

from metrics import catalog, catalog_video
from metrics.catalog import MS_SSIM, PSNR, SSIM
from metrics.conventions import CONVENTIONS
from rlbench import registry

ALL = [getattr(module, name) for module in (catalog, catalog_video) for name in module.__all__]
METRICS = [metric for metric in ALL if not metric.whole_clip]
INSTALLED = registry.load_run_metrics().values()
JUDGING = [metric for metric in INSTALLED if "counts" not in metric.needs]
DIRECTED = [metric for metric in METRICS if metric.direction and not metric.scores_previous]
PAGE = (Path(__file__).parents[2] / "docs/reference/metrics.md").read_text().splitlines()
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


def judge(metric, last_pixel):
    """Error of a grey clip whose last frame has one pixel of this radiance; larger is worse."""
    frame = None
    for index in range(3):
        halves = 0.4 * torch.rand(2, *SIZE, generator=torch.Generator().manual_seed(index))[:, :1]
        image = halves.mean(0)
        if index == 2:
            image[..., 80, 90] = last_pixel
        frame = metric.compare(image, *halves, static=True, previous=frame)
    score = metric.at(*SIZE[2:]).score(frame).item()
    return {"higher": -score, "lower": score, "": abs(score)}[metric.direction]


@pytest.mark.parametrize("metric", JUDGING, ids=lambda m: m.name)
def test_a_nonfinite_pixel_is_at_least_as_bad_as_any_finite_one(metric):
    worst = max(judge(metric, value) for value in (0.0, 0.1, 0.5, 1.0, 3e38))
    for value in (math.nan, math.inf, -math.inf):
        assert worst <= judge(metric, value) < math.inf


def test_a_metric_of_effort_judges_no_image_and_has_no_direction():
    assert {metric.direction for metric in INSTALLED if "counts" in metric.needs} == {""}


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
    metric = MS_SSIM.at(*size)
    assert metric.name == name
    image = torch.rand(1, 3, *(min(side, 161) for side in size))
    torch.testing.assert_close(score(metric, image, image, image), torch.ones(1))


@pytest.mark.parametrize("generic", [SSIM, MS_SSIM, SSIM.under("hable")], ids=lambda m: m.name)
def test_similarity_is_nan_below_its_window_size(generic):
    image = torch.rand(2, 3, 10, 96)
    metric = generic.at(10, 96)
    assert score(metric, image, image, image).isnan().tolist() == [True, True]
    assert "below 11 pixels" in metric.convention or "@" in metric.name
    assert PSNR.at(10, 96) is PSNR


def test_the_page_has_the_row_of_every_metric():
    for metric in (registry.load_plugin("metrics", n) for n in registry.list_plugins("metrics")):
        convention = metric.convention.replace("|", "&#124;")
        signed = "-" if "counts" in metric.needs else "zero"  # a metric of effort judges no image
        unit, better = metric.unit or "-", metric.direction or signed
        assert len(metric.convention) > 10
        assert metric.source
        assert f"| `{metric.name}` | {unit} | {better} | {convention} | {metric.source} |" in PAGE


def test_the_page_has_the_row_of_every_convention():
    rows = {f"| `{each.name}` | {each.sentence} |" for each in CONVENTIONS.values()}
    assert rows <= set(PAGE)
