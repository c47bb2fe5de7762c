"""The metrics as functions: other libraries, the rows of a run, and what cannot be compared."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from PIL import Image
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

import rlbench
from rlbench import metrics, registry
from tests.apps.dumps.exr_files import write_image
from tests.apps.dumps.test_primaries import ACESCG, REC709
from tests.apps.dumps.test_primaries import image as colours
from tests.apps.dumps.test_primaries import write as write_primaries
from tests.conftest import write_noise

H, W = 180, 200


@pytest.fixture(scope="module")
def pair():
    """An image and its reference, [h w 3] float32 in [0, 1]."""
    generator = np.random.default_rng(7)
    rows, columns, _ = np.indices((H, W, 3)) / H
    reference = (0.5 + 0.4 * np.sin(9 * rows) * np.cos(7 * columns)).astype(np.float32)
    noise = generator.normal(0, 0.05, (H, W, 3)).astype(np.float32)
    return (reference + noise).clip(0, 1), reference


def test_psnr_and_ssim_are_those_of_scikit_image(pair, tmp_path):
    image, reference = pair
    linear = {"convention": "linear"}
    expected = peak_signal_noise_ratio(reference, image, data_range=1)
    assert metrics.psnr(image, reference, **linear) == pytest.approx(expected, abs=1e-4)
    gaussian = {"gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False}
    _, full = structural_similarity(
        *pair, data_range=1, channel_axis=-1, full=True, win_size=11, **gaussian
    )
    inside = full[5:-5, 5:-5].mean()  # ours has the windows that lie inside the image
    assert metrics.ssim(image, reference, **linear) == pytest.approx(inside, abs=1e-5)
    mask = np.zeros((H, W), bool)
    mask[20:90, 31:] = True
    expected = peak_signal_noise_ratio(reference[mask], image[mask], data_range=1)
    assert metrics.psnr(image, reference, mask=mask, **linear) == pytest.approx(expected, abs=1e-4)
    bytes_of_pair = [np.round(255 * each).astype(np.uint8) for each in pair]
    expected = peak_signal_noise_ratio(*bytes_of_pair, data_range=255)
    found = metrics.psnr(*bytes_of_pair, data_range=255, **linear)
    assert found == pytest.approx(expected, abs=1e-4)
    files = [tmp_path / "i.png", tmp_path / "r.png"]  # decoded, and encoded again
    for file, values in zip(files, bytes_of_pair, strict=True):
        Image.fromarray(values).save(file)
    assert metrics.psnr(*files) == pytest.approx(expected, abs=1e-4)


def test_tensors_arrays_files_and_batches_have_the_same_values(pair, tmp_path):
    image, reference = (torch.from_numpy(each).movedim(-1, 0) for each in pair)
    expected = metrics.score(image, reference)
    files = [write_image(tmp_path / f"{n}.exr", each) for n, each in zip("ir", pair, strict=True)]
    doubles = image.double(), reference.double()
    for same in (pair, files, [str(file) for file in files], doubles):
        assert metrics.score(*same) == pytest.approx(expected, rel=1e-6)
    batch = torch.stack([image, reference])
    found = metrics.score(batch, reference)
    assert {name: float(values[0]) for name, values in found.items()} == pytest.approx(expected)
    assert found["psnr"].tolist() == pytest.approx([expected["psnr"], 100.0])
    assert found.metrics["psnr"].unit == "dB"
    assert metrics.psnr(2 * image, 2 * reference, data_range=2) == pytest.approx(expected["psnr"])


def test_values_are_those_of_the_rows_of_a_run(tmp_path):
    """Every metric of a run, those of motion and of counts too; a row holds float32."""
    clip = rlbench.open_clip(write_noise(tmp_path / "noise", h=24, w=32, frames=4))
    rows = rlbench.run("mean", clips=clip.arrays.folder, spp=2, out=tmp_path / "r", times="none")
    results = list(rlbench.run_clip(rlbench.load_method("mean"), clip, spp=2.0))
    frames = [result.frame for result in results]
    options = {
        "counts": torch.cat([result.samples.counts for result in results]),
        "max_samples": 8,
        "motion": torch.cat([frame.gbuffer.motion for frame in frames]),
    }
    images = torch.cat([result.image for result in results])
    halves = tuple(
        torch.cat([getattr(frame.reference, half) for frame in frames])
        for half in ("half_a", "half_b")
    )
    for name, metric in registry.load_run_metrics().items():
        ((found, values),) = metrics.score(images, halves, name, **options).items()
        row = rows[(rows["metric"] == found) & (rows["frame"] >= 0)].sort_values("frame")
        assert len(row) == len(frames) - metric.previous_frames, name
        np.testing.assert_allclose(values.numpy(), row["value"], rtol=1e-5, atol=1e-6, err_msg=name)
    first = frames[0].reference
    assert metrics.psnr(results[0].image[0], first) == pytest.approx(
        rows[(rows["metric"] == "psnr") & (rows["frame"] == 0)]["value"].item(), abs=1e-4
    )
    assert metrics.drift(images, halves) == pytest.approx(
        float(metrics.psnr(images, halves)[3] - metrics.psnr(images, halves)[0]), abs=1e-4
    )


def test_metrics_of_plugins_and_optional_packages_are_functions_too(pair, tmp_path):
    plugin = tmp_path / "l1.py"
    plugin.write_text(
        "from metrics.metric import Metric\n"
        "METRIC = Metric('l1', '', 'lower', 'linear radiance',"
        " lambda c: (c.image - c.reference).abs().mean((1, 2, 3)))\n"
    )
    rlbench.use_plugin(plugin)
    assert metrics.l1(*pair) == pytest.approx(np.abs(pair[0] - pair[1]).mean())
    assert 0 < metrics.flip(*pair) < 1
    assert {"psnr", "l1", "flip", "score"} <= set(dir(metrics))
    with pytest.raises(ValueError, match="l1 needs all pixels, as it sees neighbours"):
        metrics.l1(*pair, mask=np.ones((H, W), bool))
    with pytest.raises(AttributeError, match="no function 'psnrr'.*Did you mean 'psnr'"):
        metrics.psnrr  # noqa: B018


def test_a_pixel_that_is_not_finite_has_the_largest_error(pair):
    image, reference = (each.copy() for each in pair)
    image[3, 4, 0] = np.nan
    assert metrics.nonfinite(image) == 1.0
    worst = np.where(reference[3, 4] < 0.2140411, 1, 0)  # sRGB 0.5
    replaced = image.copy()
    replaced[3, 4] = worst
    # a marked pixel counts 1 in every channel, a replaced one at most 1
    assert metrics.psnr(image, reference) <= metrics.psnr(replaced, reference)
    assert metrics.ssim(image, reference) == pytest.approx(metrics.ssim(replaced, reference))


GREY = np.full((20, 24, 3), 0.5, np.float32)
HOLE = np.where(np.arange(20)[:, None, None] == 4, np.nan, GREY).astype(np.float32)
TENSOR = torch.full((3, 20, 24), 0.5)
REFUSED = {
    "sizes": (lambda m: m.psnr(GREY, GREY[:10]), "image has 24 x 20 pixels, and reference 24 x 10"),
    "channels": (lambda m: m.psnr(TENSOR.movedim(0, -1), TENSOR), "Channels are first in a tensor"),
    "integers": (lambda m: m.psnr(np.uint8(GREY), GREY), "uint8: give the value of display white"),
    "reference": (lambda m: m.psnr(GREY, HOLE), "reference has NaN or infinite pixels: 24 of 480"),
    "no reference": (lambda m: m.psnr(GREY), "psnr needs a reference"),
    "halves": (lambda m: m.psnr_debiased(GREY, GREY), "needs a pair of independent half"),
    "motion": (lambda m: m.flicker([GREY] * 3, GREY), "flicker needs motion"),
    "frames": (lambda m: m.tpsnr(GREY, GREY), "tpsnr needs 2 frames in order, or more; there is 1"),
    "counts": (lambda m: m.at_cap(GREY), "at_cap needs counts"),
    "batches": (lambda m: m.psnr([GREY] * 3, [GREY] * 2), "there are 3 images, and of reference 2"),
    "mask": (lambda m: m.ssim(GREY, GREY, mask=GREY[..., 0] > 0), "needs all pixels.*Crop"),
    "empty mask": (lambda m: m.psnr(GREY, GREY, mask=GREY[..., 0] < 0), "leaves no pixel"),
    "convention": (lambda m: m.psnr(GREY, GREY, convention="pq"), "'pq' is no convention"),
    "small": (lambda m: m.ms_ssim(GREY, GREY), "returns ms_ssim_1, which is another metric"),
    "metric": (lambda m: m.score(GREY, GREY, "psnrr"), "Did you mean 'psnr'"),
    "file": (lambda m: m.psnr("nowhere.exr", GREY), "there is no file nowhere.exr"),
}  # fmt: skip


@pytest.mark.parametrize(("compare", "message"), REFUSED.values(), ids=REFUSED.keys())
def test_what_cannot_be_compared_is_said(compare, message):
    with pytest.raises(rlbench.RlbenchError, match=message):
        compare(metrics)


def test_a_mask_leaves_out_pixels_of_the_reference_that_are_not_finite():
    mask = np.isfinite(HOLE).all(-1)
    assert metrics.psnr(GREY, HOLE, mask=mask) == 100.0
    assert sorted(metrics.score(GREY, HOLE, mask=mask)) == [
        "bias", "nonfinite", "psnr", "relmse", "relmse_trimmed", "smape",
    ]  # fmt: skip


def test_other_chromaticities_are_converted(tmp_path):
    file = write_primaries(tmp_path / "aces.exr", ACESCG, chromaticities=ACESCG)
    assert metrics.psnr(file, colours(REC709)) > 90
    assert metrics.psnr(colours(ACESCG), colours(REC709)) < 40  # as they are in the file
