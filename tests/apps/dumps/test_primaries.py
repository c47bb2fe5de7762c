"""Primaries of EXR files: published matrices, and one image in several spaces."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import OpenEXR
import pytest

from rlbench.apps.dumps.importers.layout import decode_layout
from rlbench.apps.dumps.lint.clip_arrays import import_arrays
from rlbench.clips.exr import read_exr
from rlbench.clips.header import ClipError
from rlbench.clips.linear_images import LooseImageError, read_linear
from rlbench.clips.primaries import REC709, Chromaticities, convert_to_rec709, matrix_to_rec709
from rlbench.errors import SourceError
from tests.apps.dumps.exr_files import LAYOUT, write_image

ACESCG = (0.713, 0.293, 0.165, 0.83, 0.128, 0.044, 0.32168, 0.33767)
ACES = (0.7347, 0.2653, 0.0, 1.0, 0.0001, -0.077, 0.32168, 0.33767)
REC2020 = (0.708, 0.292, 0.17, 0.797, 0.131, 0.046, 0.3127, 0.329)
XYZ = (1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.3127, 0.329)  # of D65
H, W = 8, 12


@pytest.mark.parametrize(
    ("primaries", "published"),
    [  # ITU-R BT.2087; OpenColorIO's ACES configuration (Bradford); IEC 61966-2-1, annex F
        (REC2020, [1.6605, -0.5876, -0.0728, -0.1246, 1.1329, -0.0083, -0.0182, -0.1006, 1.1187]),
        (ACESCG, [1.7051, -0.6218, -0.0833, -0.1303, 1.1408, -0.0105, -0.024, -0.129, 1.153]),
        (ACES, [2.5217, -1.1341, -0.3876, -0.2765, 1.3727, -0.0962, -0.0154, -0.153, 1.1684]),
    ],
    ids=["Rec. 2020", "ACEScg", "ACES2065-1"],
)
def test_matrices_are_those_that_are_published(primaries, published):
    # the publications round to four digits
    np.testing.assert_allclose(matrix_to_rec709(primaries).ravel(), published, atol=1e-4)


def test_xyz_is_a_space_of_primaries_too():
    scaled = matrix_to_rec709(XYZ) @ np.linalg.inv(np.diag([0.3127 / 0.329, 1, 0.3583 / 0.329]))
    published = [3.2404542, -1.5371385, -0.4985314, -0.969266, 1.8760108, 0.041556]  # Lindbloom
    published += [0.0556434, -0.2040259, 1.0572252]
    # RGB of XYZ primaries is XYZ over that of white
    np.testing.assert_allclose(scaled.ravel(), published, atol=2e-3)  # his white has five digits


def test_what_rec709_cannot_show_is_clipped_and_counted_and_noise_below_0_stays():
    pixels = np.array([[[0, 1, 0], [0.5, 0.5, 0.5], [0.2, -0.1, 0.3]]], np.float32)
    converted, outside = convert_to_rec709(pixels, REC2020)
    assert outside.tolist() == [[True, False, False]]
    np.testing.assert_allclose(converted[0, 0], [0, 1.1329, 0], atol=1e-4)
    assert converted[0, 2].min() < 0


def image(primaries: Chromaticities) -> np.ndarray:
    """The same colours [h w 3] in any space."""
    rec709 = np.random.default_rng(0).uniform(0.1, 1, (H, W, 3))
    return np.asarray(rec709 @ np.linalg.inv(matrix_to_rec709(primaries)).T, np.float32)


def write(path: Path, primaries: Chromaticities, **attributes) -> Path:
    """A file of colours and depth; the attributes alone say what the primaries are."""
    names = [*"RGB", "depth.R", "depth.G", "depth.B"]
    return write_image(path, np.tile(image(primaries), 2), names, **attributes)


@pytest.mark.parametrize(
    ("primaries", "attributes"),
    [
        (ACESCG, {"chromaticities": ACESCG}),
        (REC2020, {"colorInteropID": "lin_rec2020_scene"}),
        (ACES, {"chromaticities": ACES, "colorInteropID": "lin_ap0_scene"}),
        (REC709, {"chromaticities": REC709, "colorInteropID": "lin_rec709_scene"}),
        (REC709, {"colorInteropID": "data"}),
    ],
)
def test_files_of_any_primaries_show_the_same_colours(tmp_path, primaries, attributes):
    path = write(tmp_path / "dump" / "0001.exr", primaries, **attributes)
    np.testing.assert_allclose(read_linear(path), image(REC709), atol=1e-5)
    file = {"files": "{frame}.exr", "channels": ["R", "G", "B"]}
    tables = {name: file for name in ("radiance", "reference", "albedo")}
    tables["depth"] = {"files": "{frame}.exr", "channels": ["depth.R"]}
    arrays = import_arrays(path.parent, decode_layout(tables, "test"))
    for found in (arrays.pools["path"][0, 0], arrays.half_a[0], arrays.gbuffer["albedo"][0]):
        np.testing.assert_allclose(found.movedim(0, -1).numpy(), image(REC709), atol=1e-5)
    np.testing.assert_array_equal(arrays.gbuffer["depth"][0, 0], image(primaries)[..., 0])


def test_parts_share_what_one_of_them_says(tmp_path):
    planes = {c: image(ACESCG)[..., i].copy() for i, c in enumerate("RGB")}
    parts = [
        OpenEXR.Part({**LAYOUT, "chromaticities": ACESCG}, {"Z": planes["R"]}, "depth"),
        OpenEXR.Part(dict(LAYOUT), planes, "beauty"),
    ]
    OpenEXR.File(parts).write(str(tmp_path / "p.exr"))
    np.testing.assert_allclose(read_linear(tmp_path / "p.exr"), image(REC709), atol=1e-5)


@pytest.mark.parametrize(
    ("attributes", "message"),
    [
        ({"colorInteropID": "srgb_rec709_scene"}, "colorInteropID is 'srgb_rec709_scene'"),
        ({"chromaticities": (0.3, 0.3, 0.4, 0.4, 0.5, 0.5, 0.3, 0.3)}, "chromaticities span no"),
        ({"chromaticities": (*REC709[:6], 0.3, 0.0)}, "chromaticities span no"),  # no white
        ({"chromaticities": (np.nan, *REC709[1:])}, "chromaticities span no"),
    ],
)
def test_colours_of_no_linear_space_are_refused_by_name(tmp_path, attributes, message):
    path = write(tmp_path / "dump" / "0001.exr", REC709, **attributes)
    with pytest.raises(LooseImageError, match=rf"0001\.exr: its {message}"):
        read_linear(path)
    layout = decode_layout({k: {"files": "{frame}.exr"} for k in ("radiance", "reference")}, "test")
    with pytest.raises(SourceError, match=rf"0001\.exr: its {message}"):
        import_arrays(path.parent, layout)


def test_an_image_of_a_clip_in_another_space_is_refused_by_name(tmp_path):
    path = write(tmp_path / "c" / "referenceA.0000.exr", ACESCG, chromaticities=ACESCG)
    with pytest.raises(ClipError, match="chromaticities red 0.713 0.293.*rlbench import"):
        read_exr(path, ["R", "G", "B"], H, W)
