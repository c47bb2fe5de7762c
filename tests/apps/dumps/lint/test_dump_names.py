"""What names say: numbers of files, names of channels; and what no name claims."""

from __future__ import annotations

from pathlib import Path, PurePath

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rlbench.apps.dumps.importers.file_pattern import match_pattern
from rlbench.apps.dumps.importers.layout import decode_layout
from rlbench.apps.dumps.lint.dump_names import WORDS, classify, find_named_images, list_unclaimed
from rlbench.apps.dumps.lint.file_numbers import find_patterns
from rlbench.errors import SourceError
from tests.apps.dumps.exr_files import write_file

FRAMES = range(3)
REFERENCES = [f"ref_{f:04d}.exr" for f in FRAMES]
NAMES = [  # names of frames f and numbers n; these; patterns
    ("frame_{f:04d}.spp{n}.exr", FRAMES, (1, 2), "frame_{frame}.spp{spp}.exr"),
    ("x_{f:04d}.{n}.exr", FRAMES, (5, 6, 7, 8), "x_{frame}.{sample}.exr"),
    ("x.{f}.{n:04d}.exr", FRAMES, (7, 8), "x.{frame}.{sample}.exr"),  # the frame first
    ("acc{n}/{f}.exr", FRAMES, (1, 2), "acc{spp}/{frame}.exr"),
    ("v{n:03d}/a.{f}.exr", FRAMES, (1, 2), "v001/a.{frame}.exr v002/a.{frame}.exr"),  # versions
    ("sh{n:03d}/a.{f}.exr", FRAMES, (10, 20), "sh{clip}/a.{frame}.exr"),  # shots
    ("sh010/a.{f}.exr", FRAMES, "-", "sh010/a.{frame}.exr"),
    ("shot{f:04d}.exr", FRAMES, "-", "shot{frame}.exr"),  # which only looks like a shot
    ("a.udim1001.{f}.exr", FRAMES, "-", "a.udim1001.{frame}.exr"),
    ("a_1920x1080_{f}.exr", FRAMES, "-", "a_1920x1080_{frame}.exr"),
    ("a{f}.exr", (9, 10, 11), "-", "a{frame}.exr"),  # no padding
    ("a.{f}.exr", (-1, 0, 1), "-", "a.{frame}.exr"),
    ("a{f}.exr", (-1, 0, 1), "-", "a{frame}.exr"),  # a sign after a word
    ("a{f}.exr", (-2, -1), "-", "a-{frame}.exr"),  # a dash
    ("{f}/a.{f:04d}.exr", FRAMES, "-", "{frame}/a.*.exr"),
    ("ref{n}/{f}.exr", FRAMES, "AB", "ref{half}/{frame}.exr"),
    ("[old]_a.{f}.exr", FRAMES, "-", "*old*_a.{frame}.exr"),
]


@pytest.mark.parametrize(("template", "frames", "numbers", "patterns"), NAMES)
def test_the_numbers_of_names_are_told_apart(template, frames, numbers, patterns):
    paths = [template.format(f=f, n=n) for f in frames for n in numbers]
    found = find_patterns([*paths, *REFERENCES], lambda path: path.startswith("ref_"))
    assert sorted(set(found) - {"ref_{frame}.exr"}) == patterns.split()


WORD = st.from_regex(r"[a-z]{3,6}", fullmatch=True).filter(
    lambda word: not word.endswith("spp") and word not in ("seq", "scene", "ver", "shot", "acc")
)


@settings(max_examples=200)
@given(
    st.sets(st.integers(-99, 9999), min_size=2, max_size=5),
    st.sets(st.integers(0, 40), min_size=1, max_size=3),
    st.integers(1, 6),
    st.sampled_from(["s", "sample", "seed"]),
    WORD,
    st.booleans(),
)
def test_frames_and_samples_are_read_back_from_any_names(
    frames, samples, width, label, word, is_folder
):
    def name(frame: int, sample: int) -> str:
        number = f"{'-' * (frame < 0)}{abs(frame):0{width}d}"
        numbered = f"{word}.{number}.{label}{sample}.exr", f"{label}{sample}/{word}.{number}.exr"
        return numbered[is_folder]

    names = {name(f, s): (f, s) for f in frames for s in samples}
    (pattern,) = find_patterns(names)
    assert {path: match_pattern(pattern, PurePath(path))[1:3] for path in names} == names


@settings(max_examples=200)
@given(st.lists(st.from_regex(r"[a-zA-Z0-9_./\-\[\]{}*]{1,12}", fullmatch=True), max_size=8))
def test_every_file_matches_its_pattern(paths):
    for pattern, files in find_patterns(set(paths)).items():
        for path in files:
            assert match_pattern(pattern, PurePath(path)) or PurePath(path).as_posix() != path


LAYERS = [(name, word) for name, words in WORDS.items() for word in words if len(word) > 4]


@settings(max_examples=200)
@given(
    st.sampled_from(LAYERS),
    st.sampled_from(["", "ViewLayer.", "beauty.", "VRay", "RenderLayer.", "x_"]),
    st.sampled_from([str.lower, str.upper, str.capitalize]),
)
def test_a_word_is_known_in_any_case_and_layer(layer, prefix, case):
    name, word = layer
    first = classify(prefix + case(word))[0]
    assert first == name or list(WORDS).index(first) < list(WORDS).index(name)


@settings(max_examples=200)
@given(st.text())
def test_any_text_is_classified(text):
    name, place = classify(text)
    assert not name or place < len(WORDS[name])


@pytest.mark.parametrize(
    ("name", "layers"),
    [
        ("normal", ["N", "Nn", "VRayNormals"]),
        ("depth", ["Z", "z", "VRayZDepth", "FinalImageMovieRenderQueue_WorldDepth"]),
        ("radiance", ["C", "Ci", "RGBA", "FinalImage", "V.Noisy Image"]),
        ("albedo", ["diffuse_albedo", "VRayDiffuseFilter"]),
        ("motion", ["VRayVelocity"]),
        ("", ["ActorHitProxyMask", "irradiance", "crypto_object00"]),
    ],
)
def test_the_layers_of_renderers_are_known(name, layers):
    assert {layer: classify(layer)[0] for layer in layers} == dict.fromkeys(layers, name)


def flat(value: float, *names: str) -> dict[str, np.ndarray]:
    return {name: np.full((8, 12), value, np.float32) for name in names}


def write_both(folder: Path, planes: dict[str, np.ndarray], name: str = "a") -> None:
    """A sample and a reference of these planes."""
    for kind in ("sample0", "reference"):
        write_file(folder / kind / f"{name}.1.exr", {"": planes})


def test_an_image_whose_values_contradict_its_name_is_passed_over(tmp_path):
    beauty = flat(0.5, "R", "G", "B")
    unit = flat(1.0, "Normal.X") | flat(0.0, "Normal.Y", "Normal.Z")
    wrong = flat(7.0, "WorldNormal.X", "WorldNormal.Y", "WorldNormal.Z")
    write_both(tmp_path, beauty | unit | wrong)
    found = find_named_images(tmp_path)
    assert found["normal"].channels == ("Normal.X", "Normal.Y", "Normal.Z")


def test_the_newest_version_is_read(tmp_path):
    for version in (2, 10, 9):
        write_both(tmp_path, flat(0.5, *"RGB"), f"v{version}/a")
    assert find_named_images(tmp_path)["radiance"].pattern == "sample{sample}/v10/a.{frame}.exr"


def test_the_image_of_the_most_samples_is_the_reference_where_no_name_is(tmp_path):
    for spp in (1, 2, 1024):
        write_file(tmp_path / f"view.{spp}spp.0001.exr", {"": flat(0.5, *"RGB")})
    found = find_named_images(tmp_path)
    assert found["reference"] == found["radiance"]


def test_channels_that_nothing_reads_are_listed_with_their_range_and_what_they_could_be(tmp_path):
    ramp = np.linspace(0, 1, 96, dtype=np.float32).reshape(8, 12)
    layers = {
        "Mist.Z": ramp,
        "Id.V": np.round(9 * ramp),
        "Far.V": 50 * ramp,
        "A": np.ones_like(ramp),
        **dict.fromkeys(["UV.U", "UV.V", "P.Y", "P.Z", "Tint.R", "Tint.G", "Tint.B"], ramp),
        "P.X": ramp - 0.5,
        "Flat.V": 0 * ramp + 3,
    }
    write_both(tmp_path, flat(0.5, *"RGB") | layers)
    tables = {name: image.to_table() for name, image in find_named_images(tmp_path).items()}
    lines = list_unclaimed(tmp_path, decode_layout(tables, "guess"))
    assert {line.split(" (")[0]: line.split("): ")[1] for line in lines} == {
        "A": "1 to 1, alpha",
        "Far.V": "0 to 50, could be depth",
        "Flat.V": "3 to 3, a constant",
        "Id.V": "0 to 9, could be ids or a mask",
        "Mist.Z": "0 to 1, could be a mask, an opacity or scaled depth",
        "P.X, P.Y, P.Z": "-0.5 to 1, could be positions, motion or a velocity",
        "Tint.B, Tint.G, Tint.R": "0 to 1, could be albedo, or another colour",
        "UV.U, UV.V": "0 to 1, could be texture coordinates",
    }


@pytest.mark.parametrize(
    ("file", "message"),
    [
        ("Normal.1.exr", "no image looks like radiance"),
        ("beauty.0001.png", "it holds: beauty.0001.png"),
        ("clip.toml", "is a clip already"),
    ],
)
def test_no_layout_is_guessed_for_what_is_no_dump(tmp_path, file, message):
    (tmp_path / file).write_text("")
    if file.endswith(".exr"):
        write_file(tmp_path / file, {"": flat(0.5, *"XYZ")})
    with pytest.raises(SourceError, match=message):
        find_named_images(tmp_path)


@pytest.mark.parametrize("others", [("envLight", "color2"), ("emissive", "ref_emissive")])
def test_parts_of_light_are_not_taken_for_the_whole(tmp_path, others):
    for name in ("color", "ref", *others):
        write_file(tmp_path / f"{name}_0001.exr", {"": flat(1, *"RGB")})
    found = find_named_images(tmp_path)
    assert found["radiance"].pattern == "color_{frame}.exr"
    assert found["reference"].pattern == "ref_{frame}.exr"
