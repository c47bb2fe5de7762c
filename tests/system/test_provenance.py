"""Provenance: commits of clean and changed checkouts, versions, the machine."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import subprocess
from pathlib import Path

import pytest
import torch

from rlbench.system.provenance import (
    commit,
    compute_software,
    machine,
    missing_packages,
    package_versions,
    versions,
)


def _git(folder: Path, *arguments: str) -> str:
    author = ("-c", "user.name=a", "-c", "user.email=a@b")
    command = ["git", "-C", str(folder), *author, *arguments]
    return subprocess.run(command, capture_output=True, text=True).stdout.strip()


@pytest.fixture
def checkout(tmp_path):
    _git(tmp_path, "init")
    (tmp_path / "code.py").write_text("1\n")
    _git(tmp_path, "add", ".")
    _git(tmp_path, "commit", "-m", "first")
    return tmp_path


def test_a_checkout_is_its_commit_with_a_plus_if_it_was_changed(checkout):
    assert commit(checkout) == _git(checkout, "rev-parse", "HEAD")[:12]
    (checkout / "code.py").write_text("2\n")
    assert commit(checkout) == _git(checkout, "rev-parse", "HEAD")[:12] + "+"


def test_a_package_installed_inside_another_checkout_or_in_none_has_no_commit(
    checkout, tmp_path_factory
):
    installed = checkout / "site-packages" / "rlbench"
    installed.mkdir(parents=True)
    assert commit(installed) == commit(tmp_path_factory.mktemp("outside")) == ""


def test_versions_are_those_of_the_installed_packages():
    assert versions() == {"python": platform.python_version()} | {
        name: importlib.metadata.version(name) for name in ("torch", "mitsuba", "rlbench")
    }


def test_the_software_of_a_gpu_includes_its_driver(monkeypatch, tmp_path):
    program = tmp_path / "nvidia-smi"
    program.write_text("#!/bin/sh\necho 580.95.05\necho 580.95.05\n")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=os.pathsep)
    monkeypatch.setattr(torch.version, "cuda", "13.0")
    found = compute_software("cuda")
    assert found == f"{compute_software('cpu')}, CUDA 13.0, driver 580.95.05"


def test_the_machine_is_described():
    described = machine()
    assert described.cores >= 1
    assert described.cpu
    assert platform.system() in described.os


def test_a_package_that_is_not_installed_is_listed_as_missing_and_has_no_version():
    packages = ["no-such-package", "torch"]
    assert missing_packages(packages) == ["no-such-package"]
    torch = importlib.metadata.version("torch")
    assert package_versions(packages) == f"no-such-package none, torch {torch}"
