"""The writers on the page of the clip format: their clips are read back and pass the linter."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from rlbench.apps.dumps.lint.checks import lint_clip
from rlbench.apps.dumps.lint.clip_arrays import ClipArrays, read_clip_arrays
from rlbench.checks.result import Verdict
from rlbench.clips.stored import verify
from tests.apps.dumps.lint.broken_fixtures import correct_clip

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


@pytest.fixture(scope="module")
def arrays() -> ClipArrays:
    return correct_clip(frames=3)


def code_of(language: str) -> str:
    (code,) = re.findall(rf"```{language}\n(.*?)```", PAGE.read_text(), re.DOTALL)
    return code


def write_by_python(arrays: ClipArrays, folder: Path) -> None:
    names: dict[str, object] = {}
    exec(code_of("python"), names)
    for t in range(len(arrays)):
        gbuffer = {k: image[t].movedim(0, -1).numpy() for k, image in arrays.gbuffer.items()}
        images = (arrays.pools["path"][t], arrays.half_a[t], arrays.half_b[t])
        radiance = [image.movedim(-3, -1).numpy() for image in images]
        names["write_frame"](folder, t, gbuffer, *radiance)
    h, w = arrays.half_a.shape[-2:]
    names["write_header"](folder, "written", w, h, len(arrays), 8, 512, 0.5)


def write_by_cpp(arrays: ClipArrays, folder: Path) -> None:
    if not shutil.which("g++"):
        pytest.skip("no g++")
    folder.mkdir(parents=True)
    source, program = folder.parent / "writer.cpp", folder.parent / "writer"
    source.write_text("#include <cstdlib>\n" + code_of("cpp") + MAIN)
    subprocess.run(["g++", "-std=c++17", "-Wall", "-Werror", source, "-o", program], check=True)
    values = b""
    for t in range(len(arrays)):
        images = [arrays.gbuffer[name][t] for name in ("albedo", "normal", "depth", "motion")]
        images += [arrays.pools["path"][t].flatten(0, 1), arrays.half_a[t], arrays.half_b[t]]
        values += b"".join(image.contiguous().numpy().tobytes() for image in images)
    h, w = arrays.half_a.shape[-2:]
    words = [program, folder, w, h, len(arrays), 8]
    subprocess.run([str(word) for word in words], input=values, check=True)


@pytest.mark.parametrize("write", [write_by_python, write_by_cpp])
def test_a_clip_of_a_writer_on_the_page_is_read_back_and_passes(write, arrays, tmp_path):
    folder = tmp_path / "clips" / "written"
    write(arrays, folder)
    assert verify(folder) == []
    found = read_clip_arrays(folder)
    for name, image in arrays.gbuffer.items():
        np.testing.assert_array_equal(found.gbuffer[name], image)
    np.testing.assert_array_equal(found.pools["path"], arrays.pools["path"])
    np.testing.assert_array_equal(found.half_b, arrays.half_b)
    results = lint_clip(found)
    assert {r.check: r.found for r in results if r.verdict is not Verdict.PASSED} == {}
