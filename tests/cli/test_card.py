"""The command card: README.md as the Hugging Face hub reads it."""

from __future__ import annotations

import hashlib
import math

import pytest
import yaml

from rlbench import registry
from rlbench.benchmark.regression.baseline import find_baseline, load_baseline
from rlbench.clips.archive import clip_digests
from rlbench.system import paths
from tests.cli.runner import rlbench
from tests.conftest import write_noise

LICENCES = {"apache-2.0", "mit", "cc-by-4.0", "cc0-1.0", "gpl-3.0", "other"}


def read(file):
    """Front matter and body of a card."""
    start, metadata, body = file.read_text(encoding="utf-8").split("---\n", 2)
    assert start == ""
    return yaml.safe_load(metadata), body


@pytest.mark.parametrize("method", ["ours", "oidn", "restir+oidn", "oidn/retrained-small"])
def test_a_weights_card_has_valid_metadata_and_the_weights_beside_it(method, tmp_path):
    rlbench("card", "weights", method, "--out", tmp_path)
    metadata, body = read(tmp_path / "README.md")
    assert metadata["license"] in LICENCES
    assert metadata["library_name"] == "rlbench"
    assert metadata["pipeline_tag"] == "image-to-image"
    assert all(isinstance(tag, str) for tag in metadata["tags"])
    weights = tmp_path / registry.shipped_weights(method).name
    assert f"`{hashlib.sha256(weights.read_bytes()).hexdigest()}`" in body
    assert weights.with_suffix(".toml").is_file()


def test_scores_of_a_weights_card_are_those_of_the_baseline(tmp_path):
    rlbench("card", "weights", "ours", "--out", tmp_path)
    (model,) = read(tmp_path / "README.md")[0]["model-index"]
    (result,) = model["results"]
    assert set(result) == {"task", "dataset", "metrics"}  # that the hub requires
    entries = [e for e in load_baseline(find_baseline("mini")).entries if e.method == "ours"]
    for metric in result["metrics"]:
        (spp,) = {e.target_spp for e in entries if f"at {e.target_spp:g} spp" in metric["name"]}
        own = [e.psnr for e in entries if e.target_spp == spp]
        assert math.isclose(metric["value"], sum(own) / len(own), abs_tol=0.005)
    assert len(result["metrics"]) == len({e.target_spp for e in entries})


def test_a_dataset_card_lists_every_clip_with_its_digest(tmp_path):
    folders = [paths.clips_folder() / "tiny" / name for name in ("city", "temple")]
    for folder in folders:
        write_noise(folder, folder.name, preset="tiny", licence="CC-BY-4.0")
    rlbench("card", "dataset", "tiny", "--out", tmp_path)
    metadata, body = read(tmp_path / "README.md")
    assert metadata["license"] == "cc-by-4.0"
    assert metadata["size_categories"] == ["n<1K"]
    assert metadata["task_categories"] == ["image-to-image"]
    for folder in folders:
        assert f"| {folder.name} | {folder.name} | 24x20 | 3 |" in body
        assert clip_digests(folder)["path"][:12] in body


def test_a_licence_that_the_hub_does_not_name_is_other(tmp_path):
    write_noise(paths.clips_folder() / "tiny" / "city", preset="tiny", licence="My own")
    rlbench("card", "dataset", "tiny", "--out", tmp_path)
    metadata, _ = read(tmp_path / "README.md")
    assert (metadata["license"], metadata["license_name"]) == ("other", "my-own")


def test_a_method_without_weights_has_no_card():
    assert "mean ships no weights" in rlbench("card", "weights", "mean", code=2)
    assert "no preset 'minni'" in rlbench("card", "dataset", "minni", code=2)


def test_a_card_without_a_folder_is_printed():
    assert rlbench("card", "weights", "ours").startswith("--- license:")
