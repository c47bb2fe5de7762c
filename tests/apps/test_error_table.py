"""What a user sees after a frequent mistake: one row each, with the words that help."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import pytest

from tests.apps.dumps.importers.sources import write_oidn
from tests.cli.runner import ENVIRONMENT, rlbench
from tests.conftest import write_noise, write_plugin

Words = tuple[object, ...]


class Mistake(NamedTuple):
    """A command with a mistake, its exit code and a pattern of what it has to print."""

    words: Callable[[Path], Words]
    pattern: str
    code: int = 2


def own_clip(folder: Path, *options: object) -> Words:
    clip = write_noise(folder / "clips" / "city", "imported-city")
    return ("run", "mean", "--clips", clip, "--spp", 1, "--out", folder / "r", *options)


def nan_method(folder: Path) -> Words:
    body = "return samples.mean * float('nan'), None"
    plugin = write_plugin(folder / "nan.py", "nan", body=body)
    return (*own_clip(folder, "--plugin", plugin), "-m", "nan")


def dump(folder: Path) -> Words:
    write_oidn(folder / "dump", frames=1, seeds=1)
    return ("run", "-m", "mean", "--clips", folder / "dump", "--out", folder / "r")


def run(*words: object) -> Callable[[Path], Words]:
    return lambda folder: ("run", *words, "--out", folder / "r")


TABLE = {
    "more spp than a preset stores": Mistake(
        run("-m", "mean", "--spp", 16),
        "clips of preset 'mini' store 8 samples per pixel.* or trace more with --pool live",
    ),
    "more spp than a method supports, live": Mistake(
        run("-m", "svgf", "--spp", 16, "--pool", "live"),
        "error: --spp 16: svgf supports 1 to 8 spp, requested 16",
    ),
    "more spp than a clip stores": Mistake(
        lambda folder: (*own_clip(folder), "--spp", 16),
        "no psnr on city: 16 spp requested, the clip stores 8 samples per pixel; request at most 8",
        code=1,
    ),
    "a method whose image is all NaN": Mistake(
        nan_method, "nan: 480 of 480 pixels not finite in frame 0 of city at 1 spp", code=1
    ),
    "an own clip without a cost": Mistake(
        own_clip,
        r"give your renderer's time: --cost mine.toml \(docs/how-to/charge-your-renderer.md\)",
        code=0,
    ),
    "a folder as weights": Mistake(
        lambda folder: ("run", "-m", "ours", "--weights", folder, "--out", folder / "r"),
        "is a folder, not a weights file. It holds no weights",
    ),
    "an import without a layout": Mistake(
        lambda folder: ("import", folder, "--out", folder / "r"),
        "--layout is missing: rlbench lint --guess ",
    ),
    "a device that torch does not know": Mistake(
        run("-m", "mean", "--device", "gpu"),
        r"error: device gpu cannot be used on this machine, it is not known\. "
        r"Use cpu, cuda or auto$",
    ),
    "a folder that does not exist": Mistake(
        run("-m", "mean", "--clips", "nowhere"), "error: nowhere does not exist. Name a folder"
    ),
    "a folder of EXR files": Mistake(
        dump, "dump holds EXR files and no clip. To make clips of them: rlbench import .*dump"
    ),
}


@pytest.mark.parametrize("mistake", TABLE.values(), ids=TABLE)
def test_a_mistake_is_answered_with_what_helps(tmp_path, mistake):
    output = rlbench(*mistake.words(tmp_path), code=mistake.code)
    assert re.search(mistake.pattern, output), output
    assert "Traceback" not in output
    if mistake.code == 2:  # nothing is rendered or written
        assert not (tmp_path / "r").exists()
        assert not (tmp_path / "cache").exists()


@pytest.mark.parametrize(("package", "kind"), [("metrics", "metrics"), ("baselines", "methods")])
def test_a_file_that_shadows_a_package_is_named(tmp_path, package, kind):
    file = tmp_path / f"{package}.py"
    file.write_text("")
    command = [sys.executable, "-m", "rlbench", "list", kind, "--json"]
    process = subprocess.run(
        command, capture_output=True, text=True, cwd=tmp_path, env=ENVIRONMENT, check=False
    )
    advice = "run from another folder, or rename that file"
    assert f"`{package}` is shadowed by {file}: {advice}" in process.stdout
    assert process.returncode == 1
