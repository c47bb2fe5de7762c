"""Tests of text files that say what is done already."""

from pathlib import Path

import pytest

from rlbench.system.store import claim, read_text, recall


@pytest.mark.parametrize(("stored", "is_kept"), [("new", True), ("old", False), (None, False)])
def test_files_stay_where_the_key_beside_them_is_the_one_asked_for(
    tmp_path: Path, stored: str | None, is_kept: bool
) -> None:
    image, key_file = tmp_path / "0000.exr", tmp_path / "key.txt"
    image.touch()
    if stored:
        key_file.write_text(stored)
    claim(key_file, "new", older=[image, tmp_path / "absent.exr"])
    assert (image.exists(), read_text(key_file)) == (is_kept, "new")


def test_an_answer_is_found_once_for_each_key(tmp_path: Path) -> None:
    answers = iter([1.5, 2.5])
    keys = ["a", "b", "a"]
    found = [recall(tmp_path / "answers.json", key, lambda: next(answers)) for key in keys]
    assert found == [1.5, 2.5, 1.5]
