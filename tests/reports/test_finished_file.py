"""A file appears whole or not at all."""

from __future__ import annotations

import pytest

from reports.layout.finished_file import finished_file


def test_a_file_has_its_new_content_after_the_block(tmp_path):
    file = tmp_path / "new" / "a.txt"
    with finished_file(file) as temporary:
        temporary.write_text("all of it")
        assert not file.exists()
    assert file.read_text() == "all of it"
    assert list(file.parent.iterdir()) == [file]


def test_an_error_leaves_the_old_file_and_nothing_else(tmp_path):
    def write_half():
        with finished_file(file) as temporary:
            temporary.write_text("half")
            raise ZeroDivisionError

    file = tmp_path / "a.txt"
    file.write_text("old")
    with pytest.raises(ZeroDivisionError):
        write_half()
    assert file.read_text() == "old"
    assert list(tmp_path.iterdir()) == [file]
