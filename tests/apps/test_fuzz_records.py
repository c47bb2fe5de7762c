"""Whatever a record on disk holds: the right content, or one error that a user can act on.

Records are model cards, weights, baselines and row files, and the other files that a stranger may
send: clips, images, archives, layouts, cost profiles, ledgers, pins, queues.
"""

from __future__ import annotations

import hashlib
import json
import math
import tempfile
from collections.abc import Callable
from dataclasses import asdict, replace
from functools import cache
from pathlib import Path

import msgspec
import numpy as np
import pandas as pd
import pytest
import safetensors.torch
import tomli_w
import torch
from hypothesis import strategies as st
from torch import nn

from rlbench.apps.dumps.importers.layout import read_layout, ready_layouts
from rlbench.apps.dumps.importers.zarr_v2 import open_archive, read_array
from rlbench.apps.render.scenes.collection.pins import Pin, PinnedFile, format_pin, read_pin
from rlbench.benchmark import looks, results
from rlbench.benchmark.cell_key import CellId, CellKey
from rlbench.benchmark.cost_profile import PROFILES, read_profile
from rlbench.benchmark.regression.baseline import SCHEMA, load_baseline
from rlbench.benchmark.results import Row
from rlbench.clips.exr import read_exr, write_exr
from rlbench.clips.header import FILE, read_header
from rlbench.clips.linear_images import read_linear
from rlbench.clips.pfm import write_pfm
from rlbench.errors import RlbenchError
from rlbench.training.queue import read_queue
from rlbench.weights import ModelCard, card_path, load_into, read_card, save, training_clips
from tests.apps.dumps.importers.sources import noisebase_arrays, zarr_zip
from tests.apps.fuzzing import (
    COUNTS,
    DATES,
    NESTED,
    VALUES,
    draw_change,
    examples,
    fuzz,
    fuzz_in_a_process,
    result_or_error,
    with_other_values,
)
from tests.conftest import write_noise

# Model cards and weights

CARD = ModelCard(
    "oidn/tuned",
    ("city 01", "hall 02"),
    frames_seen=1200,
    steps=400,
    seconds=12.5,
    validation_history=((1, 2.0),),
)
WEIGHTS = nn.Linear(3, 2)


def card_contents() -> st.SearchStrategy[bytes]:
    document = asdict(replace(CARD, sha256="0" * 64))
    text = tomli_w.dumps(document).encode()
    values = with_other_values(document, st.one_of(VALUES, DATES))
    nested = NESTED.map(lambda value: f"name = {value}\n".encode())
    encoded = values.map(lambda changed_: tomli_w.dumps(changed_).encode())
    return st.one_of(draw_change(text), encoded, nested)


def read_changed_card(content: bytes) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "oidn.safetensors"
        path.touch()
        card_path(path).write_bytes(content)
        card = result_or_error(read_card, path)
        if isinstance(card, RlbenchError):
            assert str(card_path(path)) in str(card)
            assert training_clips(path) == frozenset()
            return
        assert msgspec.convert(asdict(card), ModelCard) == card or _has_nan(card)
        assert all(isinstance(clip, str) for clip in training_clips(path))


def _has_nan(card: ModelCard) -> bool:
    return any(value != value for value in (card.seconds, *sum(card.validation_history, ())))


test_a_changed_card_is_read_or_refused = examples(read_changed_card, card_contents())


HALVES = {name: tensor.half() for name, tensor in WEIGHTS.state_dict().items()}


def with_bits(bits: bytes) -> bytes:
    """A weights file whose six weights have these bits, NaN and infinity among them."""
    weight = torch.frombuffer(bytearray(bits), dtype=torch.float16).reshape(2, 3)
    return safetensors.torch.save({**HALVES, "weight": weight})


def weight_contents() -> st.SearchStrategy[tuple[bytes, bool]]:
    """Contents of weight files, and whether the card has the hash of the changed file."""
    bits = st.lists(st.sampled_from([b"\0\x3c", b"\0\x7c", b"\1\xfc", b"\xff\x7b"]), min_size=6)
    values = bits.map(lambda chunks: with_bits(b"".join(chunks[:6])))
    return st.tuples(st.one_of(draw_change(safetensors.torch.save(HALVES)), values), st.booleans())


def load_changed_weights(example: tuple[bytes, bool]) -> None:
    content, has_hash = example
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "oidn.safetensors"
        card = save(WEIGHTS, path, CARD)
        path.write_bytes(content)
        if has_hash:
            text = card_path(path).read_text()
            new = hashlib.sha256(content).hexdigest()
            card_path(path).write_text(text.replace(card.sha256, new))
        module = nn.Linear(3, 2)
        before = {name: value.clone() for name, value in module.state_dict().items()}
        loaded = result_or_error(load_into, module, path)
        if isinstance(loaded, RlbenchError):
            assert str(path) in str(loaded)
            assert all(torch.equal(v, before[k]) for k, v in module.state_dict().items())
            return
        for name, value in module.state_dict().items():
            assert torch.isfinite(value).all()
            assert has_hash or torch.equal(value, WEIGHTS.state_dict()[name].half().float())


test_changed_weights_are_loaded_or_refused = examples(load_changed_weights, weight_contents())


# Baselines

ENTRY = {"method": "ours", "scene": "city", "target_spp": 2.0, "psnr": 30.0, "tolerance_db": 0.1}
BASELINE = {"schema": SCHEMA, "preset": "mini", "command": "", "seed": 0, "speed": []}
BASELINE |= {"tolerance_db": 0.05, "entries": [ENTRY]}


def baseline_contents() -> st.SearchStrategy[bytes]:
    entries = with_other_values(ENTRY, VALUES).map(lambda entry: {**BASELINE, "entries": [entry]})
    documents = st.one_of(with_other_values(BASELINE, VALUES), entries, VALUES)
    encoded = documents.map(lambda document: json.dumps(document).encode())
    return st.one_of(draw_change(json.dumps(BASELINE).encode()), encoded, NESTED.map(str.encode))


def read_changed_baseline(content: bytes) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "mini.json"
        path.write_bytes(content)
        baseline = result_or_error(load_baseline, path)
        if isinstance(baseline, RlbenchError):
            assert str(path) in str(baseline)
            return
        assert msgspec.convert(asdict(baseline), type(baseline)) == baseline
        numbers = [
            (baseline.tolerance_db, entry.psnr, entry.target_spp) for entry in baseline.entries
        ]
        assert all(math.isfinite(number) for entry in numbers for number in entry)


test_a_changed_baseline_is_read_or_refused = examples(read_changed_baseline, baseline_contents())


# Row files

ROW = Row("r", "ours/A1", "city-0", "city", 2.0, 1.99, 0, "psnr", 31.25, "dB", "higher", "sRGB")
ROWS = [replace(ROW, frame=frame, value=30.0 + frame) for frame in range(4)]
KEY = CellKey("ours/A1", "city-0", 2.0, 0, "a CPU, 2 threads")
CELL, OTHER = CellId(KEY, "a"), CellId(replace(KEY, seed=1), "a")


def row_file(cell: CellId, rows: list[Row]) -> tuple[str, bytes]:
    """Name and content of the row file of a cell."""
    with tempfile.TemporaryDirectory() as folder:
        file = results.write_cell(Path(folder), cell, rows)
        return file.name, file.read_bytes()


NAME, CONTENT = row_file(CELL, ROWS)
OTHER_NAME, OTHER_CONTENT = row_file(OTHER, ROWS[:1])
TABLE = results.to_dataframe([*ROWS, ROWS[0]])


def read_changed_rows(content: bytes) -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / OTHER_NAME).write_bytes(OTHER_CONTENT)
        (folder / NAME).write_bytes(content)
        table = result_or_error(results.read, folder)
        if not isinstance(table, RlbenchError):
            pd.testing.assert_frame_equal(table, TABLE)
            assert results.set_aside_damaged(folder) == []
            return
        assert str(folder / NAME) in str(table)
        if "has schema" not in str(table):  # which a newer version may have written
            assert len(results.set_aside_damaged(folder)) == 1
            assert results.cells(folder) == {OTHER}


test_a_changed_row_file_is_read_or_refused = examples(read_changed_rows, draw_change(CONTENT))


# Other files of strangers

LEDGER = b"date,preset,methods,cells,code_hash\n2026-01-01T00:00:00Z,mini,mean,3,ab\n"
PIN = format_pin(Pin("owner/scenes", "0" * 40, "a", (PinnedFile("scene.xml", "1" * 40, 12),)))
QUEUE = b'[[training]]\nname = "a"\nmethods = "ours"\nminutes = 5\n'


def written(write: Callable[[Path], object], name: str) -> bytes:
    """The content of a file that a function writes into a folder."""
    with tempfile.TemporaryDirectory() as folder:
        write(Path(folder))
        return (Path(folder) / name).read_bytes()


@cache
def archive_bytes() -> bytes:
    return written(lambda folder: zarr_zip(folder / "a.zip", noisebase_arrays(0, 2)), "a.zip")


def read_archive(file: Path) -> None:
    with open_archive(file) as archive:
        for key in ("color", "reference", "exposure"):
            assert read_array(archive, key).nbytes < 2**24


PLANE = np.linspace(0, 1, 20 * 12, dtype=np.float32).reshape(20, 12)
PLANES = {"R": PLANE, "G": PLANE.astype(np.float16), "B": PLANE.round(1)}


def read_two_planes(file: Path) -> None:
    assert read_exr(file, ["R", "G"], 20, 12).shape == (2, 20, 12)


STRANGERS: dict[str, tuple[str, Callable[[], bytes], Callable[[Path], object]]] = {
    "ledger": (looks.FILE, lambda: LEDGER, lambda file: looks.count_looks(file.parent)),
    "pin": ("room.tsv", PIN.encode, read_pin),
    "queue": ("queue.toml", lambda: QUEUE, lambda file: read_queue(file, ["methods", "minutes"])),
    "layout": ("a.toml", ready_layouts()["blender"].read_bytes, lambda f: read_layout(str(f))),
    "cost": ("a.toml", (PROFILES / "paper-2080ti.toml").read_bytes, lambda f: read_profile(str(f))),
    "header": (FILE, lambda: written(write_noise, FILE), lambda file: read_header(file.parent)),
    "exr": ("a.exr", lambda: written(write_noise, "referenceA.0000.exr"), read_linear),
    "exr planes": (
        "a.exr",
        lambda: written(lambda folder: write_exr(folder / "a.exr", PLANES), "a.exr"),
        read_two_planes,
    ),
    "pfm": (
        "a.pfm",
        lambda: written(lambda f: write_pfm(f / "a.pfm", np.ones((3, 4, 3), "f4")), "a.pfm"),
        read_linear,
    ),
    "zip": ("a.zip", archive_bytes, read_archive),
}


@pytest.mark.parametrize("count", COUNTS)
@pytest.mark.parametrize("kind", STRANGERS)
def test_a_changed_file_of_a_stranger_is_read_or_refused(kind, count, tmp_path):
    name, content, read = STRANGERS[kind]
    file = tmp_path / "folder" / name
    file.parent.mkdir()

    def check(changed: bytes) -> None:
        file.write_bytes(changed)
        found = result_or_error(read, file)
        if isinstance(found, RlbenchError):
            assert file.stem in str(found)
        assert [each.name for each in file.parent.iterdir()] == [name]

    run = fuzz_in_a_process if name.endswith(".exr") else fuzz
    run(count, draw_change(content()), check)
