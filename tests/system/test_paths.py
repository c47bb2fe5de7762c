"""The cache folder follows the variable, and files are written whole or not at all."""

from __future__ import annotations

import pytest

from rlbench.system import paths


def test_the_cache_lies_where_the_variable_says(tmp_path, monkeypatch):
    monkeypatch.setenv("RLBENCH_CACHE", str(tmp_path / "elsewhere"))
    assert paths.cache_folder() == tmp_path / "elsewhere"
    assert paths.clips_folder().parent == paths.decoded_folder().parent == paths.cache_folder()


def test_the_cache_of_a_user_is_used_without_the_variable(tmp_path, monkeypatch):
    monkeypatch.delenv("RLBENCH_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert paths.cache_folder().name == "rlbench"


def test_a_home_folder_in_the_variable_is_expanded(monkeypatch):
    monkeypatch.setenv("RLBENCH_CACHE", "~/cache")
    assert "~" not in str(paths.cache_folder())


def test_a_file_appears_only_when_it_is_complete(tmp_path):
    path = tmp_path / "folder" / "file.txt"
    with paths.atomic_write(path) as temporary:
        temporary.write_text("new")
        assert not path.exists()
    assert path.read_text() == "new"
    assert list(path.parent.iterdir()) == [path]


def write_and_fail(path):
    with paths.atomic_write(path) as temporary:
        temporary.write_text("new")
        raise ZeroDivisionError


def test_an_error_leaves_the_old_file_and_no_temporary_one(tmp_path):
    path = tmp_path / "file.txt"
    path.write_text("old")
    with pytest.raises(ZeroDivisionError):
        write_and_fail(path)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]
