"""A correct clip passes all checks, and each fault fails exactly its own; the command lint."""

from __future__ import annotations

import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from rlbench.apps.dumps.lint.checks import check_finite, lint_clip
from rlbench.apps.dumps.lint.clip_arrays import ClipArrays, read_clip_arrays
from rlbench.apps.dumps.lint.motion import check_motion
from rlbench.checks.result import Verdict
from rlbench.clips.stored import open_clip, verify
from tests.apps.dumps.lint.broken_fixtures import FAULTS, break_values, correct_clip, store
from tests.cli.runner import rlbench

QUICK = (  # faults of one clip, which always run; each fault alone is slow
    {
        "motion": "y points up",
        "albedo": "it is sRGB",
        "sample independence": "two samples share half of their pixels",
        "reference halves": "they overlap",
    },
    {"depth": "it is the distance to the camera", "independent seeds": "half A contains the pool"},
    {"normal": "they are in camera space"},
    {"orientation": "the G-buffer is upside down"},
)
EACH = ({check: fault} for check, faults in FAULTS.items() for fault in faults)


def failed_checks(folder: Path) -> list[str]:
    return [f.check for f in lint_clip(read_clip_arrays(folder)) if f.verdict is Verdict.FAILED]


def test_a_correct_clip_passes_every_check(folder):
    found = lint_clip(read_clip_arrays(folder))
    assert {f.check: f.found for f in found if f.verdict is not Verdict.PASSED} == {}


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_other_correct_clips_fail_no_check(tmp_path, seed):
    assert failed_checks(store(correct_clip(seed), tmp_path / "correct")) == []


@pytest.mark.parametrize(
    "faults", [*QUICK, *(pytest.param(each, marks=pytest.mark.slow) for each in EACH)], ids=str
)
def test_faults_fail_their_own_checks_and_no_other(arrays, tmp_path, faults):
    for check, fault in faults.items():
        arrays = FAULTS[check][fault](arrays)
    assert sorted(failed_checks(store(arrays, tmp_path / "faulty"))) == sorted(faults)


def test_a_failed_check_says_how_to_fix_it(arrays):
    found = check_motion(FAULTS["motion"]["it is in NDC"](arrays))
    assert found.remedy == "convert it from (x, y) in NDC (-1..1), to the previous frame"


def test_a_nan_fails_one_check_which_reports_its_place(arrays, tmp_path):
    faulty = store(arrays, tmp_path / "faulty")
    break_values(faulty, arrays)
    found = [f for f in lint_clip(read_clip_arrays(faulty)) if f.verdict is Verdict.FAILED]
    assert [f.check for f in found] == ["finite values"]
    assert "2 in reference A; first: reference A frame 1 at x 5, y 3" in found[0].found


def test_infinite_depth_psr_glass_is_background_too(arrays):
    behind = arrays.gbuffer["depth"].clone()
    behind[0, 0, 3, 4] = torch.inf
    more = replace(arrays, gbuffer={**arrays.gbuffer, "depth_psr": behind})
    assert check_finite(more).verdict is Verdict.PASSED
    assert more.sanitized.gbuffer["depth_psr"][0, 0, 3, 4] == torch.inf


def test_the_command_passes_and_writes_a_figure(folder, tmp_path):
    output = rlbench("lint", folder, "--figure", tmp_path / "figure.png", "--frames", 3)
    assert "failed: 0" in output
    assert (tmp_path / "figure.png").read_bytes().startswith(b"\x89PNG")


def test_the_command_fails_where_a_check_does(arrays, tmp_path):
    store(FAULTS["reference halves"]["they are equal"](arrays), tmp_path / "clips" / "faulty")
    assert "both halves are the same image" in rlbench("lint", tmp_path / "clips", code=1)


def test_arrays_equal_those_of_the_clip_reader(arrays, folder):
    frame = open_clip(folder, seed=3).frame(2)
    read = read_clip_arrays(folder)
    assert torch.equal(read.gbuffer["motion"][2, None], frame.gbuffer.motion)
    assert torch.equal(read.reference[2, None] * 0.5, frame.reference.mean)
    assert len(read_clip_arrays(folder, 2)) == 2  # the requested frames alone


# The writers on the page of the clip format


PAGE = Path(__file__).parents[4] / "docs" / "reference" / "clip-format.md"
MAIN = """
int main(int count, char** words) {  // FOLDER WIDTH HEIGHT FRAMES SAMPLES, floats from stdin
    const std::string folder = words[1];
    const int width = std::stoi(words[2]), height = std::stoi(words[3]);
    const int frames = std::stoi(words[4]), samples = std::stoi(words[5]);
    auto take = [&](Channels& channels, const std::string& layer, const std::string& letters) {
        for (char letter : letters) {
            std::vector<float> plane(size_t(width) * height);
            if (!std::fread(plane.data(), 4, plane.size(), stdin)) std::exit(1);
            channels[layer + letter] = plane;
        }
    };
    for (int frame = 0; frame < frames; ++frame) {
        Channels view, pool, a, b;
        take(view, "albedo.", "RGB"), take(view, "normal.", "XYZ");
        take(view, "depth.", "Z"), take(view, "motion.", "XY");
        for (int s = 0; s < samples; ++s) take(pool, "s" + std::to_string(s) + ".", "RGB");
        take(a, "", "RGB"), take(b, "", "RGB");
        write_exr(frame_file(folder, "view", frame), width, height, view);
        write_exr(frame_file(folder, "pool.path", frame), width, height, pool);
        write_exr(frame_file(folder, "referenceA", frame), width, height, a);
        write_exr(frame_file(folder, "referenceB", frame), width, height, b);
    }
    write_header(folder, "written", width, height, frames, samples, 512, 0.5);
}
"""


def code_of(language: str) -> str:
    (code,) = re.findall(rf"```{language}\n(.*?)```", PAGE.read_text(), re.DOTALL)
    return code


def write_by_python(short: ClipArrays, folder: Path) -> None:
    names: dict[str, object] = {}
    exec(code_of("python"), names)
    for t in range(len(short)):
        gbuffer = {k: image[t].movedim(0, -1).numpy() for k, image in short.gbuffer.items()}
        images = (short.pools["path"][t], short.half_a[t], short.half_b[t])
        radiance = [image.movedim(-3, -1).numpy() for image in images]
        names["write_frame"](folder, t, gbuffer, *radiance)
    h, w = short.half_a.shape[-2:]
    names["write_header"](folder, "written", w, h, len(short), 8, 512, 0.5)


def write_by_cpp(short: ClipArrays, folder: Path) -> None:
    if not shutil.which("g++"):
        pytest.skip("no g++")
    folder.mkdir(parents=True)
    source, program = folder.parent / "writer.cpp", folder.parent / "writer"
    source.write_text("#include <cstdlib>\n" + code_of("cpp") + MAIN)
    subprocess.run(["g++", "-std=c++17", "-Wall", "-Werror", source, "-o", program], check=True)
    values = b""
    for t in range(len(short)):
        images = [short.gbuffer[name][t] for name in ("albedo", "normal", "depth", "motion")]
        images += [short.pools["path"][t].flatten(0, 1), short.half_a[t], short.half_b[t]]
        values += b"".join(image.contiguous().numpy().tobytes() for image in images)
    h, w = short.half_a.shape[-2:]
    words = [program, folder, w, h, len(short), 8]
    subprocess.run([str(word) for word in words], input=values, check=True)


@pytest.mark.parametrize("write", [write_by_python, write_by_cpp])
def test_a_clip_of_a_writer_on_the_page_is_read_back_and_passes(write, short, tmp_path):
    folder = tmp_path / "clips" / "written"
    write(short, folder)
    assert verify(folder) == []
    found = read_clip_arrays(folder)
    for name, image in short.gbuffer.items():
        np.testing.assert_array_equal(found.gbuffer[name], image)
    np.testing.assert_array_equal(found.pools["path"], short.pools["path"])
    np.testing.assert_array_equal(found.half_b, short.half_b)
    results = lint_clip(found)
    assert {r.check: r.found for r in results if r.verdict is not Verdict.PASSED} == {}
