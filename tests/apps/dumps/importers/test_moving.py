"""Motion of imported frames: camera jitter is taken out, and the sky moves with the camera."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import qmc

from rlbench.apps.dumps.importers import formats, writer
from rlbench.apps.dumps.importers.conversions import OUTSIDE
from rlbench.apps.dumps.importers.jitter import halton_offset, read_offsets
from rlbench.apps.dumps.importers.layout import Camera, decode_layout, ready_layouts
from rlbench.apps.dumps.importers.sequence import ImportedSequence
from rlbench.apps.dumps.importers.sky import judge_sky, motion_at_infinity
from rlbench.apps.dumps.lint.checks import lint_clip
from rlbench.apps.dumps.lint.clip_arrays import ClipArrays, read_clip_arrays
from rlbench.apps.dumps.lint.guess import guess_layout
from rlbench.checks.result import Verdict
from rlbench.clips.header import ClipError, read_header
from rlbench.errors import SourceError
from tests.apps.dumps.importers.dumps import FOV, camera_axes, write_blender, write_falcor
from tests.apps.dumps.lint.broken_fixtures import correct_clip, still_sky


@pytest.fixture(scope="module")
def small() -> ClipArrays:
    return correct_clip(height=48, width=64, frames=4, half=64)


def dump_jittered(small: ClipArrays, folder: Path, sign: float = 1.0) -> None:
    """A dump of Falcor whose motion contains the change of the first Halton offsets."""
    offsets = torch.tensor([halton_offset(i) for i in range(len(small))])
    change = torch.cat([offsets[:1] - torch.tensor(halton_offset(7)), offsets.diff(dim=0)])
    motion = small.gbuffer["motion"] + sign * change.view(-1, 2, 1, 1)
    write_falcor(replace(small, gbuffer={**small.gbuffer, "motion": motion}), folder)


def sequence(source: Path, camera: str, motion: str = "", reference: str = "") -> ImportedSequence:
    """The sequence that Falcor's layout finds, with more keys."""
    text = ready_layouts()["falcor"].read_text()
    text = text.replace("[reference]", f"[reference]\n{reference}")
    layout = source.parent / "engine.toml"
    layout.write_text(f"{text}\n{motion}\n{camera}")
    (found,) = formats.find_sequences(source, str(layout))
    return found


def motion_of(found: ImportedSequence) -> np.ndarray:
    frames = [found.read(number, 1).gbuffer["motion"] for number in found.numbers]
    return np.moveaxis(np.stack(frames), -1, 1)


@pytest.mark.parametrize(
    ("jitter", "sign", "more"),
    [("halton 8", 1.0, ""), ("halton 8", -1.0, "scale = -1.0"), ("offsets.txt", 1.0, "")],
)
def test_methods_get_motion_without_the_jitter(small, tmp_path, jitter, sign, more):
    dump_jittered(small, tmp_path / "dump", sign)
    lines = ["# x, y", *("{}, {}".format(*halton_offset(i)) for i in range(4))]
    (tmp_path / "dump" / "offsets.txt").write_text("\n".join(lines))
    found = sequence(tmp_path / "dump", f'[camera]\njitter = "{jitter}"\n{more}', "jittered = true")
    first = 1 if jitter == "offsets.txt" else 0  # no offset is known before the first of a file
    # pixels; stored as shares of the image in single precision
    expected = small.gbuffer["motion"]
    np.testing.assert_allclose(motion_of(found)[first:], expected[first:], atol=1e-4)
    assert found.jitter[2] == pytest.approx([sign * v for v in halton_offset(2)])


def test_motion_that_is_without_jitter_stays_and_the_reference_is_said(small, tmp_path):
    write_falcor(small, tmp_path / "dump")
    found = sequence(tmp_path / "dump", '[camera]\njitter = "halton 16"')
    np.testing.assert_allclose(motion_of(found), small.gbuffer["motion"], atol=1e-4)
    assert "halton 16" in found.notes[-1]
    assert "the reference is not jittered" in found.notes[-1]
    with pytest.raises(SourceError, match=r"needs \[camera\] jitter"):
        sequence(tmp_path / "dump", "", "jittered = true")


def test_offsets_are_in_the_header_and_a_jittered_reference_is_a_limitation(small, tmp_path):
    write_falcor(small, tmp_path / "dump")
    found = sequence(tmp_path / "dump", '[camera]\njitter = "halton 8"', "", "jittered = true")
    header = writer.clip_header(found, 1)
    writer.write_clip(found, header, tmp_path / "clip")
    stored = read_header(tmp_path / "clip")
    assert stored.jitter == tuple(halton_offset(i) for i in range(4))
    assert stored.limitations == ("reference jitter",)
    assert stored.digest_fields("path").keys() == header.digest_fields("path").keys()
    for wrong in (((9.0, 0.0),) * 4, ((0.0, 0.0),)):
        with pytest.raises(ClipError, match="jitter"):
            replace(header, jitter=wrong)


def test_the_jitter_of_a_dump_is_guessed(small, tmp_path):
    dump_jittered(small, tmp_path / "dump")
    guess = guess_layout(tmp_path / "dump")
    assert guess.tables["motion"]["jittered"] is True
    assert decode_layout(guess.tables, "guess").camera == Camera(jitter="halton 8")


# The table of offsets


@settings(max_examples=200)
@given(st.integers(0, 2000))
def test_offsets_are_those_of_a_halton_sequence(index):
    points = qmc.Halton(2, scramble=False).fast_forward(index + 1).random(1)[0] - 0.5
    assert halton_offset(index) == pytest.approx(points, abs=1e-12)


FLOATS = st.floats(-2, 2, width=32)


@settings(max_examples=200)
@given(
    st.lists(st.tuples(FLOATS, FLOATS), min_size=1, max_size=20),
    st.sampled_from([" ", ", ", "\t", ";"]),
    st.booleans(),
    st.floats(-2, 2),
)
def test_a_table_of_offsets_is_read_back(tmp_path_factory, table, separator, is_up, scale):
    folder = tmp_path_factory.getbasetemp()
    lines = [f"{x!r}{separator}{y!r}  # {i}\n" for i, (x, y) in enumerate(table)]
    (folder / "table.txt").write_text("\ufeff# offsets\n\n" + "".join(lines))
    camera = Camera(jitter="table.txt", scale=scale, y="up" if is_up else "down")
    offset = read_offsets(camera, folder)
    sign = -1 if is_up else 1
    found = [offset(i) for i in range(len(table))]
    assert found == [(x * scale, y * sign * scale) for x, y in table]
    with pytest.raises(SourceError, match="line for each frame"):
        offset(len(table))


@settings(max_examples=200)
@given(st.binary(max_size=80))
def test_any_file_of_offsets_is_read_or_an_error(tmp_path_factory, content):
    folder = tmp_path_factory.getbasetemp()
    (folder / "any.txt").write_bytes(content)
    try:
        x, y = read_offsets(Camera(jitter="any.txt"), folder)(0)
    except SourceError:
        return
    assert max(abs(x), abs(y)) <= 2


@pytest.mark.parametrize("jitter", ["halton 0", "sobol 8", ""])
def test_a_formula_that_is_not_known_is_an_error_that_shows_one(tmp_path, jitter):
    with pytest.raises(SourceError, match="halton 16"):
        read_offsets(Camera(jitter=jitter), tmp_path)


# The sky

H, W, FOCAL = 54, 72, 72 / 2 / np.tan(np.radians(30))


@pytest.fixture(scope="module")
def dump(short, tmp_path_factory) -> Path:
    """What Blender writes: no motion where nothing is hit."""
    folder = tmp_path_factory.mktemp("sky") / "dump"
    write_blender(still_sky(short), folder)
    columns = camera_axes(short).mT * torch.tensor([1, -1, -1])  # right, up and backward
    matrices = np.tile(np.eye(4), (len(short), 1, 1))
    matrices[:, :3, :3] = columns.numpy()
    (folder / "cameras.json").write_text(json.dumps(matrices.tolist()))
    return folder


def import_clip(dump: Path, out: Path, *keys: str, **options) -> ClipArrays:
    """The clip of a dump by Blender's layout with more keys in [motion]."""
    layout = out / "own.toml"
    layout.write_text("\n".join([ready_layouts()["blender"].read_text(), *keys]))
    (sequence,) = formats.find_sequences(dump, str(layout), **options)
    writer.write_clip(sequence, writer.clip_header(sequence, None, 0.5), out / "clip")
    return read_clip_arrays(out / "clip", 0)


def test_a_sky_without_motion_is_unknown_and_listed(dump, short, tmp_path):
    found = import_clip(dump, tmp_path)
    assert found.header.limitations == ("sky motion",)
    sky = short.gbuffer["depth"].isinf()[:, 0]
    h, w = sky.shape[1:]
    motion = found.gbuffer["motion"].movedim(1, -1)
    assert (motion[sky] == torch.tensor([OUTSIDE * w, OUTSIDE * h])).all()
    expected = short.gbuffer["motion"].movedim(1, -1)[~sky]
    torch.testing.assert_close(motion[~sky], expected, rtol=0, atol=1e-4)  # pixels, in float32
    verdicts = {result.check: result.verdict for result in lint_clip(found)}
    assert verdicts["motion"] is verdicts["sky motion"] is Verdict.PASSED


@pytest.mark.parametrize("start", [0, 1])
def test_a_sky_moves_as_the_camera_of_its_frame_turns(dump, short, tmp_path, start):
    keys = ('camera = "cameras.json"', f"fov = {FOV}")
    found = import_clip(dump, tmp_path, *keys, frames=(1 + start, 4))
    assert found.header.limitations == ()
    unknown = 1 - start  # the first frame of the dump has no camera before it
    motion, expected = found.gbuffer["motion"], short.gbuffer["motion"][start:]
    np.testing.assert_allclose(motion[unknown:], expected[unknown:], atol=1e-4)
    sky = short.gbuffer["depth"].isinf()[start, 0]
    assert (motion[0, 0][sky] == OUTSIDE * sky.shape[1]).all() == bool(unknown)


def test_a_sky_that_is_declared_stored_stays(dump, short, tmp_path):
    found = import_clip(dump, tmp_path, 'sky = "stored"')
    sky = short.gbuffer["depth"].isinf()[:, 0]
    assert (found.gbuffer["motion"].movedim(1, -1)[sky] == 0).all()


def test_one_frame_of_many_with_a_still_sky_is_found(short, tmp_path):
    motion = short.gbuffer["motion"].clone()
    motion[1] = still_sky(short).gbuffer["motion"][1]
    write_blender(replace(short, gbuffer={**short.gbuffer, "motion": motion}), tmp_path / "dump")
    found = import_clip(tmp_path / "dump", tmp_path)
    assert found.header.limitations == ("sky motion",)
    np.testing.assert_allclose(found.gbuffer["motion"][0], short.gbuffer["motion"][0], atol=1e-4)


# The judgement, on scenes in closed form


def yaw(degrees: float) -> np.ndarray:
    """Axes to the right, down and forward as columns, turned about the vertical."""
    s, c = np.sin(np.radians(degrees)), np.cos(np.radians(degrees))
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def scene(turn: float, step: float, has_relief: bool = True) -> tuple[np.ndarray, ...]:
    """Motion, sky and depth of static surfaces below a sky without motion."""
    film = np.stack(np.meshgrid(np.arange(W) + 0.5, np.arange(H) + 0.5), -1)
    rays = np.concatenate([(film - [W / 2, H / 2]) / FOCAL, np.ones((H, W, 1))], -1)
    rng = np.random.default_rng(0)
    depth = 4 + (rng.random((H, W)) * 8 if has_relief else np.zeros((H, W)))
    points = (rays * depth[..., None]) @ yaw(turn).T + [step, 0, step / 2]
    motion = points[..., :2] / points[..., 2:] * FOCAL + [W / 2, H / 2] - film
    sky = np.arange(H)[:, None].repeat(W, 1) < H // 3
    return np.where(sky[..., None], 0, motion), sky, np.where(sky, np.inf, depth)[..., None]


@pytest.mark.parametrize(
    ("turn", "step", "surfaces", "judgement"),
    [
        (2, 0, "relief", "unwritten"),
        (2, 0.3, "relief", "unwritten"),
        (-10, 0.2, "relief", "unwritten"),
        (0, 0.3, "relief", "stored"),
        (0, -1.0, "relief", "stored"),
        (0, 0, "relief", "stored"),
        (2, 0, "a plane", "unclear"),
        (0, 0.3, "a plane", "unclear"),
        (2, 0, "no depth", "unclear"),
    ],
)
def test_a_still_sky_is_wrong_only_where_the_camera_turns(turn, step, surfaces, judgement):
    motion, sky, depth = scene(turn, step, surfaces != "a plane")
    assert judge_sky(motion, sky, None if surfaces == "no depth" else depth) == judgement


@pytest.mark.parametrize("turn", [0.5, -3, 40])
def test_points_at_infinity_move_by_a_rotation_alone(turn):
    found = motion_at_infinity(yaw(turn), yaw(0), 60, (H, W))
    angle = np.arctan((np.arange(W) + 0.5 - W / 2) / FOCAL) + np.radians(turn)
    expected = np.tan(angle) * FOCAL - (np.arange(W) + 0.5 - W / 2)
    np.testing.assert_allclose(found[H // 2, :, 0], expected, atol=1e-9)


def test_points_behind_the_previous_camera_point_outside():
    found = motion_at_infinity(yaw(180), yaw(0), 60, (H, W))
    assert (found == [OUTSIDE * W, OUTSIDE * H]).all()
