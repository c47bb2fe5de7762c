"""Damaged clips and sources: a clear error or the right result, never another exception."""

from __future__ import annotations

import io
import json
import shutil
import tomllib
import zipfile
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import OpenEXR
import pytest
import tomli_w
from hypothesis import strategies as st

from rlbench.apps.dumps.importers import formats, writer
from rlbench.clips import ClipError, read_header, verify, write_header
from rlbench.clips.header import FILE, LIMITS, is_plain_name
from rlbench.clips.image_files import Channels, read_exr_image
from rlbench.errors import RlbenchError, SourceError
from tests.apps.dumps.importers.sources import write_oidn
from tests.apps.fuzzing import COUNTS, NUMBERS, VALUES, fuzz, fuzz_in_a_process, result_or_error
from tests.apps.test_fuzz_records import archive_bytes, read_archive
from tests.clips.clip_folders import HEADER, write_clip
from tests.clips.test_image_files import KINDS, WINDOW, canvas, header

# clip.toml

KEYS = st.sampled_from(sorted([*HEADER.__dataclass_fields__, "version", "lacks"]))
TEXTS = st.sampled_from(["../x", "/etc", "..", "a/../../b", "\0"])


@pytest.mark.parametrize("count", COUNTS)
def test_a_header_with_any_values_is_refused_or_within_its_limits(count, tmp_path):
    write_header(tmp_path, HEADER)
    document = tomllib.loads((tmp_path / FILE).read_text("utf-8"))

    def check(changes: dict[str, Any]) -> None:
        (tmp_path / FILE).write_bytes(tomli_w.dumps(document | changes).encode())
        found = result_or_error(read_header, tmp_path)
        if isinstance(found, ClipError):
            return
        for key, limits in LIMITS.items():
            value = getattr(found, key)
            assert all(map(limits.allow, value if isinstance(value, tuple) else (value,)))
        assert all(is_plain_name(part) for part in found.name.split("/"))
        assert all("/" not in pool for pool in found.pools)

    values = st.one_of(VALUES, TEXTS)
    fuzz(count, st.dictionaries(KEYS, values, min_size=1, max_size=3), check)


@pytest.mark.parametrize(
    "text",
    ["x = " + "[" * 5000, "version = " + "9" * 5000, "frames = 0x" + "f" * 5000, "\0", "\xff"],
)
def test_a_header_that_strains_the_parser_is_refused(tmp_path, text):
    write_header(tmp_path, HEADER)
    lines = [line for line in (tmp_path / FILE).read_text("utf-8").splitlines()]
    lines = [line for line in lines if line.split(" ")[0] != text.split(" ")[0]]
    (tmp_path / FILE).write_bytes("\n".join([text, *lines]).encode("latin-1"))
    with pytest.raises(ClipError):
        read_header(tmp_path)


# Parts of EXR files

PARTS = st.lists(
    st.tuples(st.text("abcXYZ._ 0", min_size=1, max_size=6), WINDOW),
    min_size=2,
    max_size=4,
    unique_by=lambda part: part[0],
)


@pytest.mark.parametrize("count", COUNTS)
def test_a_part_of_a_damaged_file_is_itself_or_an_error(count, tmp_path):
    path, display = tmp_path / "parts.exr", (-8, -8, 10, 10)

    def check(example: tuple[Any, ...]) -> None:
        parts, kind, changes = example
        planes = [32 * canvas(data) + 2**16 * number for number, (_, data) in enumerate(parts, 129)]
        OpenEXR.File(
            [
                OpenEXR.Part(header(data, display, kind), {"Z": plane}, name)
                for plane, (name, data) in zip(planes, parts, strict=True)
            ]
        ).write(str(path))
        content = bytearray(path.read_bytes())
        for place, size in changes:
            start = int(place * (len(content) - 1))
            content[start : start + size] = bytes(len(content[start : start + size]))
        path.write_bytes(content)
        for number, (name, data) in enumerate(parts, 129):
            try:
                image = read_exr_image(path, Channels((("Z",),), name), fill=-1)
            except SourceError:
                assert changes
                continue
            # a zero in a header may move a window, and in a part that is stored as it is a value
            # loses the third byte of its float, which has the part's number, or all
            values = np.unique(image.pixels[~image.empty])
            assert changes or len(values) == len(np.unique(canvas(data)))
            assert set(values // 2**16) <= {number, *(128, 0) * bool(changes)}

    zeros = st.lists(st.tuples(st.floats(0, 1), st.integers(1, 256)), max_size=3)
    fuzz_in_a_process(count, st.tuples(PARTS, st.sampled_from(sorted(KINDS)), zeros), check)


# Zips

METADATA = st.dictionaries(
    st.sampled_from(["shape", "chunks", "dtype", "compressor", "fill_value", "order", "filters"]),
    st.one_of(
        st.lists(st.integers(-1, 2**40), max_size=5),
        st.sampled_from(
            ["<f4", "O", "|S9999999", "<M8[s]", "F", [4, 2**20, 2**10, 1], {"id": "zlib"}]
        ),
        NUMBERS.filter(lambda value: isinstance(value, float) or abs(value) < 2**60),
    ),
    min_size=1,
    max_size=3,
)


@pytest.mark.parametrize("count", COUNTS)
def test_an_array_with_any_metadata_is_refused_or_small(count, tmp_path):
    with zipfile.ZipFile(io.BytesIO(archive_bytes())) as archive:
        entries = {name: archive.read(name) for name in archive.namelist()}
    metadata = json.loads(entries["color/.zarray"])

    def check(changes: dict[str, Any]) -> None:
        path = tmp_path / "frame.zip"
        changed = {"color/.zarray": json.dumps(metadata | changes)}
        with zipfile.ZipFile(path, "w") as archive:
            for name, content in (entries | changed).items():
                archive.writestr(name, content)
        result_or_error(read_archive, path)

    fuzz(count, METADATA, check)


# Folders

ODD = [
    *("walk_9999999999_0001spp.hdr", "walk_0001_ref.hdr", "walk_0002_seed1_0001spp.alb"),
    *("..._0001spp.hdr", "walk_0001_seed99999999999_9999999999spp.hdr"),
]
TEXT = st.text(alphabet="walk_.0123456789 -é", min_size=1, max_size=20)
NAMES = st.one_of(st.sampled_from(ODD), TEXT.map("{}_0001spp.hdr".format)).map("{}.exr".format)
KINDS_OF_CHANGE = ["add", "swap", "cut", "folder", "delete", "replace"]
STEP = st.tuples(st.sampled_from(KINDS_OF_CHANGE), NAMES, st.integers(0, 99))
STEPS = st.lists(STEP, min_size=1, max_size=4)


@pytest.mark.parametrize("count", COUNTS)
def test_a_source_with_any_files_is_refused_or_becomes_a_valid_clip(count, tmp_path):
    template = write_oidn(tmp_path / "template", frames=2)

    def check(steps: list[tuple[str, str, int]]) -> None:
        with TemporaryDirectory(dir=tmp_path) as scratch:
            source, out = Path(scratch, "source"), Path(scratch, "out")
            shutil.copytree(template, source)
            for step in steps:
                change_folder(source, *step)
            try:
                for sequence in formats.find_sequences(source, "oidn"):
                    clip_header = writer.clip_header(sequence, None)
                    writer.write_clip(sequence, clip_header, out / sequence.name)
                    assert verify(out / sequence.name) == []
            except RlbenchError:
                pass
            assert {path.name for path in Path(scratch).iterdir()} <= {"source", "out"}

    fuzz(count, STEPS, check)


def change_folder(folder: Path, kind: str, name: str, number: int) -> None:
    files = sorted(path for path in folder.iterdir() if path.suffix == ".exr" and path.is_file())
    file = files[number % len(files)]
    if kind == "add" and not (folder / name).exists():
        shutil.copy(file, folder / name)
    elif kind == "swap":
        file.write_bytes(files[0].read_bytes())
    elif kind == "cut":
        file.write_bytes(file.read_bytes()[: number * file.stat().st_size // 99])
    elif kind == "folder":
        (folder / "inner" / name).mkdir(parents=True, exist_ok=True)
    elif kind in ("delete", "replace") and len(files) > 1:
        file.unlink()
        if kind == "replace":
            file.mkdir()


@pytest.mark.parametrize("count", COUNTS)
def test_a_clip_folder_with_damaged_files_has_problems_or_is_valid(count, tmp_path):
    template = write_clip(tmp_path / "template")

    def check(steps: list[tuple[str, str, int]]) -> None:
        with TemporaryDirectory(dir=tmp_path) as scratch:
            folder = Path(shutil.copytree(template, Path(scratch, "clip")))
            for step in steps:
                change_folder(folder, *step)
            assert all(isinstance(problem, str) for problem in verify(folder))

    fuzz(count, STEPS, check)
