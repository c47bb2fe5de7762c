"""Documents are decoded with their types checked, and read back as they were written."""

from __future__ import annotations

import math
from dataclasses import dataclass

import pytest

from rlbench.system.documents import decode, read_json, read_toml, unknown_keys, write_toml


@dataclass(frozen=True)
class Clip:
    """A document of the tests."""

    name: str
    frames: int = 1
    sample_ms: float = 0.0
    sizes: tuple[int, ...] = ()
    history: tuple[tuple[int, float], ...] = ()


def test_a_document_becomes_a_dataclass_and_an_int_a_float_where_the_field_is_one():
    document = {"name": "city", "sample_ms": 2, "sizes": [72, 128], "history": [[1, 0.5], [2, 1]]}
    expected = Clip("city", 1, 2.0, (72, 128), ((1, 0.5), (2, 1.0)))
    assert repr(decode(document, Clip)) == repr(expected)


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
def test_a_value_of_another_type_and_a_missing_key_are_errors_that_name_the_key(
    key, value, message
):
    with pytest.raises(ValueError, match=message):
        decode({"name": "city", key: value}, Clip)
    with pytest.raises(ValueError, match="missing required field `name`"):
        decode({"frames": 3}, Clip)


def test_unknown_keys_are_listed_and_ignored_in_decoding():
    document = {"title": "city", "colour": 1, "age": 2}
    assert unknown_keys(document, Clip) == ["age", "colour", "title"]
    assert decode({"name": "city", "colour": 1}, Clip) == Clip("city")


DOCUMENT = {
    "text": 'quote " backslash \\ tab \t newline \n return \r\n delete \x7f null \x00 é 光 😀',
    "numbers": [0.1, 1e-5, 1e300, -0.0, math.inf, -math.inf, math.nan],
    "nested": [[1, 2.5], [2, 3.0]],
    "flag": True,
    "empty": "",
    "nothing": [],
    "table": {"key with spaces": 1},
}


def test_a_written_document_is_read_back_identical(tmp_path):
    write_toml(tmp_path / "folder" / "a.toml", DOCUMENT)
    document = read_toml(tmp_path / "folder" / "a.toml")
    assert repr(document) == repr(DOCUMENT)  # types, the order of keys, and the sign of zero


TOML, JSON = (read_toml, "clip.toml"), (read_json, "clip.json")


@pytest.mark.parametrize(
    ("reader", "content"),
    [
        *((TOML, content) for content in (b"name = ", b'name = "\xff"', b"\x00")),
        *((JSON, content) for content in (b"{", b"\xff", b'"\xe9"', b"[NaN]", b"1e999")),
        (JSON, b"[" * 100_000),
    ],
)
def test_what_is_not_toml_or_json_is_a_value_error_with_the_file(tmp_path, reader, content):
    read, name = reader
    (tmp_path / name).write_bytes(content)
    with pytest.raises(ValueError, match=rf"clip\.{name[5:]} is not {name[5:].upper()}"):
        read(tmp_path / name)
