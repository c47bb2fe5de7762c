"""Sources of three formats: what a clip holds of them, against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from PIL import Image

from rlbench.clips.stored import StoredClip
from tests.apps.dumps.exr_files import write_image
from tests.apps.dumps.importers.sources import (
    DRIFT,
    FAR,
    WRITERS,
    ZOOM,
    H,
    W,
    display,
    display_bytes,
    grid,
    import_clip,
    noisebase_arrays,
    plane,
    pool,
    radiance,
    stored,
    write_noisebase,
    write_oidn,
    write_rl_path_tracing,
)


@pytest.fixture
def clip(request, tmp_path) -> StoredClip:
    return import_clip(WRITERS[request.param](tmp_path / "source"), request.param, tmp_path / "out")


def constant(*values: float) -> np.ndarray:
    return np.tile(np.float32(values), (H, W, 1))


def with_sky(image: np.ndarray, value: float) -> np.ndarray:
    """The image with another first row."""
    image[0] = value
    return image


def wall_motion() -> np.ndarray:
    motion = np.zeros((H, W, 2))
    motion[1:, :, 0] = -0.1 / FAR * ZOOM * W / 2  # what the camera saw further left
    motion[H // 2 :, :, 1] = -0.05 / FAR * (ZOOM * W / H) * H / 2  # was higher
    return motion


OIDN, NOISEBASE, RL = WRITERS
BUFFERS = {  # by format, frame and name
    (OIDN, 0, "albedo"): constant(0.25, 0.5, 1),  # that of the first sample, clipped
    (OIDN, 0, "normal"): with_sky(constant(0, -0.6, 0.8), 0),  # of unit length
    (NOISEBASE, 0, "albedo"): constant(0.25, 0.5, 1),
    (NOISEBASE, 0, "normal"): with_sky(constant(0, 0, -1), 0),
    (NOISEBASE, 1, "depth"): with_sky(constant(FAR), np.inf),
    (NOISEBASE, 0, "motion"): constant(0, 0),
    (NOISEBASE, 1, "motion"): wall_motion(),
    (NOISEBASE, 2, "motion"): wall_motion(),
    (RL, 1, "normal"): constant(*[2 / 255] * 3),
    (RL, 1, "albedo"): constant(*[22 / 255] * 3),
    (RL, 1, "depth"): constant(42 / 255),
    (RL, 0, "motion"): constant(0, 0),
    (RL, 1, "motion"): constant(DRIFT[0], -DRIFT[1]),  # Blender's vector with y down
}


@pytest.mark.parametrize(
    ("clip", "index", "buffer"), BUFFERS, indirect=["clip"], ids=lambda each: str(each)
)
def test_a_buffer_is_that_of_the_source_in_the_conventions_of_a_clip(request, clip, index, buffer):
    format_ = request.node.callspec.params["clip"]
    is_half = buffer in ("albedo", "normal")
    tolerance = {"rtol": 5e-4, "atol": 5e-4} if is_half else {"rtol": 1e-6, "atol": 1e-5}
    expected = BUFFERS[format_, index, buffer]
    np.testing.assert_allclose(stored(clip, index, buffer), expected, **tolerance)


def decoded_rgbe() -> np.ndarray:
    samples = noisebase_arrays(1)["color"][:3].transpose(3, 1, 2, 0) / 255
    samples[:, :, 1::2] *= 2  # exponent 255: the upper end, 2
    samples[:, :, ::2] *= 0.5  # exponent 127: half of the way from log 1/8 to log 2
    return samples


RADIANCE = {  # samples and reference of frame 1
    OIDN: (np.stack([radiance(1, seed) for seed in range(2)]), radiance(1, 8) + np.float32(1 / 3)),
    NOISEBASE: (decoded_rgbe(), constant(*[1 / 3 + 1] * 3)),
    RL: (np.stack([display(2, slot) for slot in range(8)]), display(2, 3)),
}


@pytest.mark.parametrize(("clip", "format_"), [(f, f) for f in WRITERS], indirect=["clip"])
def test_samples_and_the_reference_are_those_of_the_source(clip, format_):
    frame = clip.frame(1).reference
    found = pool(clip, 1), frame.half_a[0].permute(1, 2, 0).numpy()
    if format_ == RL:
        found = display_bytes(found[0]), display_bytes(found[1])
    rounding = 5e-4 if format_ == NOISEBASE else 0  # half precision
    np.testing.assert_allclose(found[0], RADIANCE[format_][0], rtol=rounding)
    np.testing.assert_array_equal(found[1], RADIANCE[format_][1])
    assert (frame.half_b == frame.half_a).all()


LIMITATIONS = {
    OIDN: ("halves", "normal", "no depth", "no motion"),
    NOISEBASE: ("halves", "first motion"),
    RL: ("halves", "independence", "linear", "albedo", "normal", "depth", "first motion"),
}


@pytest.mark.parametrize(("clip", "format_"), [(f, f) for f in WRITERS], indirect=["clip"])
def test_the_header_lists_the_content_and_the_limitations(clip, format_):
    header = clip.header
    spp, reference = {OIDN: (2, 1024), NOISEBASE: (6, 0), RL: (8, 1000)}[format_]
    assert (header.height, header.width, header.frames, header.pool_spp) == (H, W, 3, spp)
    assert header.buffers == ("albedo", "normal", "depth", "motion")
    assert header.reference_spp == (reference,) * 3
    assert header.limitations == LIMITATIONS[format_]


# OIDN


def test_two_references_of_one_spp_are_two_halves(tmp_path):
    clip = import_clip(write_oidn(tmp_path / "source", halves=True), "oidn", tmp_path / "out")
    b = clip.frame(2).reference.half_b[0].permute(1, 2, 0).numpy()
    np.testing.assert_array_equal(b, radiance(2, 9) + np.float32(1 / 3))
    assert "halves" not in clip.header.limitations
    assert clip.header.reference_spp == (2048,) * 3


def test_the_spp_of_a_file_named_ref_is_unknown(tmp_path):
    source = write_oidn(tmp_path / "source", frames=1)
    write_image(source / "walk_0000_ref.hdr.exr", radiance(0, 5))
    clip = import_clip(source, "oidn", tmp_path / "out")
    image = clip.frame(0).reference.half_a[0].permute(1, 2, 0).numpy()
    np.testing.assert_array_equal(image, radiance(0, 5))
    assert clip.header.reference_spp == (0,)


# Noisebase


def test_the_sky_moves_as_the_camera_turns(tmp_path):
    source = write_noisebase(tmp_path / "source", frames=2, step=0.3, yaw=0.05)
    motion = stored(import_clip(source, "noisebase", tmp_path / "out"), 1, "motion")[0]
    x, y = (side[0] for side in plane())
    turned = np.tan(np.arctan(x) - 0.05) - x, y / (np.cos(0.05) + x * np.sin(0.05)) - y
    expected = np.stack((turned[0] * W / 2 * ZOOM, -turned[1] * H / 2 * ZOOM * W / H), -1)
    np.testing.assert_allclose(motion, expected, atol=1e-4, rtol=0)  # matrices are float


def test_the_first_frame_has_motion_if_the_frame_before_it_exists(tmp_path):
    clip = import_clip(
        write_noisebase(tmp_path / "s"), "noisebase", tmp_path / "out", frames=(1, 3)
    )
    assert stored(clip, 0, "motion")[1, 0, 0] == pytest.approx(-0.1 / FAR * ZOOM * W / 2, abs=1e-5)
    assert clip.header.limitations == ("halves",)


def test_fewer_samples_are_the_first(tmp_path):
    clip = import_clip(write_noisebase(tmp_path / "s"), "noisebase", tmp_path / "out", samples=5)
    assert clip.header.pool_spp == 5
    assert pool(clip, 0)[-1, 0, 0, 0] == pytest.approx(4 / 255 / 2, rel=5e-4)  # half precision


def test_arrays_equal_those_that_zarr_reads(tmp_path):
    zarr = pytest.importorskip("zarr", reason="an oracle, not a dependency")
    write_noisebase(tmp_path, frames=1)
    store = zarr.storage.ZipStore(tmp_path / "corridor" / "frame0000.zip", mode="r")
    array = zarr.open_group(store, mode="r")["color"][:]
    np.testing.assert_array_equal(array, noisebase_arrays(0)["color"])


# RL_PATH_TRACING


@pytest.mark.parametrize("clip", [RL], indirect=True)
def test_motion_points_to_where_grid_sample_reads(clip):
    ramps = np.stack(np.meshgrid(np.arange(W), np.arange(H))).astype(np.float32)
    read = torch.nn.functional.grid_sample(
        torch.from_numpy(ramps)[None], grid(), align_corners=False
    )
    moved = read[0].permute(1, 2, 0).numpy() - ramps.transpose(1, 2, 0)
    inner = (slice(0, H - 1), slice(0, W - 2))  # where it reads nothing from beyond the border
    np.testing.assert_allclose(stored(clip, 2, "motion")[inner], moved[inner], atol=1e-5, rtol=0)


@pytest.mark.parametrize("has_motion", [True, False])
def test_motion_files_may_have_the_name_that_the_script_writes_or_be_absent(tmp_path, has_motion):
    source = write_rl_path_tracing(tmp_path / "source", corr="")
    for path in () if has_motion else source.rglob("*.pt"):
        path.unlink()
    clip = import_clip(source, RL, tmp_path / "out")
    assert stored(clip, 1, "motion")[0, 0, 0] == pytest.approx(DRIFT[0] * has_motion, abs=1e-5)
    assert ("no motion" in clip.header.limitations) == (not has_motion)
    assert not clip.header.static


def test_only_the_upper_left_720_are_kept(tmp_path):
    source = tmp_path / "emerald"
    source.mkdir()
    wide = np.zeros((722, 730, 3), np.uint8)
    wide[719, 719], wide[720:], wide[:, 720:] = 128, 255, 255
    for name in ("00-0000", "gd0000", f"add{'Denoising Albedo' * 2}0000"):
        Image.fromarray(wide).save(source / f"{name}.png")
    clip = import_clip(source, RL, tmp_path / "out")
    assert stored(clip, 0, "albedo").shape == (720, 720, 3)
    assert display_bytes(pool(clip, 0)).max() == 128
