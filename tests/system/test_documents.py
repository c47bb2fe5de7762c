"""Documents are decoded with their types checked, and read back as they were written."""

from __future__ import annotations

import math
from dataclasses import dataclass

import pytest

from rlbench.system.documents import decode, read_json, read_toml, to_toml, unknown_keys, write_toml


@dataclass(frozen=True)
class Clip:
    """A document of the tests."""

    name: str
    frames: int = 1
    sample_ms: float = 0.0
    sizes: tuple[int, ...] = ()
    history: tuple[tuple[int, float], ...] = ()


def test_a_document_becomes_a_dataclass():
    document = {"name": "city", "frames": 3, "sizes": [72, 128], "history": [[1, 0.5], [2, 1.5]]}
    assert decode(document, Clip) == Clip("city", 3, 0.0, (72, 128), ((1, 0.5), (2, 1.5)))


def test_an_int_becomes_a_float_where_the_field_is_one():
    clip = decode({"name": "city", "sample_ms": 2, "history": [[1, 2]]}, Clip)
    assert type(clip.sample_ms) is float
    assert type(clip.history[0][1]) is float


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("name", 3, r"Expected `str`, got `int`.*name"),
        ("frames", "3", r"Expected `int`, got `str`.*frames"),
        ("frames", 2.5, r"Expected `int`, got `float`.*frames"),
        ("sizes", [1, "2"], r"Expected `int`, got `str`.*sizes\[1\]"),
        ("history", [[1, 2.0, 3.0]], r"length 2.*history\[0\]"),
        ("sizes", 72, r"Expected `array`, got `int`.*sizes"),
    ],
)
def test_a_value_of_another_type_is_an_error_that_names_the_key(key, value, message):
    with pytest.raises(ValueError, match=message):
        decode({"name": "city", key: value}, Clip)


def test_a_missing_key_is_an_error_that_names_it():
    with pytest.raises(ValueError, match="missing required field `name`"):
        decode({"frames": 3}, Clip)


def test_unknown_keys_are_listed_and_ignored_in_decoding():
    document = {"title": "city", "colour": 1, "age": 2}
    assert unknown_keys(document, Clip) == ["age", "colour", "title"]
    assert decode({"name": "city", "colour": 1}, Clip) == Clip("city")


@pytest.mark.parametrize("content", [b"name = ", b'name = "\xff"', b"\x00"])
def test_a_file_that_is_not_toml_is_an_error_that_names_it(tmp_path, content):
    (tmp_path / "clip.toml").write_bytes(content)
    with pytest.raises(ValueError, match=r"clip\.toml is not TOML"):
        read_toml(tmp_path / "clip.toml")


DOCUMENT = {
    "text": 'quote " backslash \\ tab \t newline \n return \r\n delete \x7f null \x00 é 光 😀',
    "numbers": [0.1, 1e-5, 1e300, -0.0, math.inf, -math.inf],
    "nested": [[1, 2.5], [2, 3.0]],
    "flag": True,
    "empty": "",
    "nothing": [],
    "table": {"key with spaces": 1},
}


def test_a_written_document_is_read_back_identical(tmp_path):
    write_toml(tmp_path / "folder" / "a.toml", DOCUMENT)
    document = read_toml(tmp_path / "folder" / "a.toml")
    assert document == DOCUMENT
    assert list(document) == list(DOCUMENT)
    assert repr(document) == repr(DOCUMENT)  # types, and the sign of zero


def test_nan_is_read_back(tmp_path):
    write_toml(tmp_path / "a.toml", {"psnr": math.nan})
    assert math.isnan(read_toml(tmp_path / "a.toml")["psnr"])


def test_tuples_are_written_as_arrays():
    assert to_toml({"sizes": (1, 2)}) == to_toml({"sizes": [1, 2]})


def test_a_document_that_cannot_be_written_leaves_the_old_file(tmp_path):
    write_toml(tmp_path / "a.toml", {"name": "city"})
    with pytest.raises(TypeError):
        write_toml(tmp_path / "a.toml", {"name": None})
    assert read_toml(tmp_path / "a.toml") == {"name": "city"}
    assert [path.name for path in tmp_path.iterdir()] == ["a.toml"]


@pytest.mark.parametrize("content", [b"{", b"\xff", b'"\xe9"', b"[NaN]", b"1e999", b"[" * 100_000])
def test_what_is_not_json_is_a_value_error_with_the_file(tmp_path, content):
    (tmp_path / "a.json").write_bytes(content)
    with pytest.raises(ValueError, match=r"a\.json is not JSON"):
        read_json(tmp_path / "a.json")


def test_json_is_read(tmp_path):
    (tmp_path / "a.json").write_text('{"a": [1, 2.5, null]}')
    assert read_json(tmp_path / "a.json") == {"a": [1, 2.5, None]}
