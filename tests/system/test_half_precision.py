"""In what precision devices run networks by half, and what is refused where they emulate it."""

from __future__ import annotations

import contextlib
import platform
from pathlib import Path

import pytest
import torch

import rlbench as api
from rlbench.benchmark.runner import measure, read_cells
from rlbench.cli.doctor import inspect_machine
from rlbench.errors import OptionError
from rlbench.system.half_precision import (
    describe_half,
    emulation_reason,
    half_dtype,
    require_half,
)
from tests.cli.runner import rlbench
from tests.test_wrappers import half_plan

EMULATES = "the processor has no bfloat16 instructions and would emulate bfloat16"
PROCESSORS = {  # architecture and capabilities, and those that compute in bfloat16
    "Zen 4": ("x86_64", {"avx512_f": True, "avx512_bf16": True}, ["avx512_bf16"]),
    "Granite Rapids": ("x86_64", {"amx_bf16": True}, ["amx_bf16"]),
    "Skylake-SP": ("x86_64", {"avx512_f": True, "avx512_bf16": False}, []),
    "Zen 3": ("x86_64", {"avx2": True}, []),
    "Neoverse V1": ("aarch64", {"neon": True, "bf16": True}, ["bf16"]),
    "Neoverse N1": ("aarch64", {"neon": True, "bf16": False}, []),
}


@pytest.fixture
def use_processor(monkeypatch):
    def use(name: str) -> list[str]:
        architecture, known, flags = PROCESSORS[name]
        capabilities = {"architecture": architecture, **known}
        monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: capabilities)
        return flags

    return use


@pytest.mark.parametrize("name", PROCESSORS)
def test_a_processor_is_judged_by_its_instructions(name, use_processor):
    flags = use_processor(name)
    assert emulation_reason("cpu") == ("" if flags else EMULATES)
    assert all(flag in describe_half("cpu") for flag in flags)


@pytest.mark.skipif(
    platform.machine() != "x86_64" or not Path("/proc/cpuinfo").exists(), reason="reads x86 flags"
)
def test_the_answer_for_this_processor_is_that_of_its_flags():
    flags = Path("/proc/cpuinfo").read_text().split()
    assert bool(emulation_reason("cpu")) == (not {"avx512_bf16", "amx_bf16"} & set(flags))


@pytest.mark.parametrize(
    ("capability", "reason"),
    [((7, 5), "NVIDIA RTX has compute capability 7.5 and would emulate"), ((8, 0), "")],
)
def test_a_cuda_device_is_judged_by_its_capability(capability, reason, monkeypatch):
    is_native = capability >= (8, 0)
    monkeypatch.setattr(torch.cuda, "device", lambda device: contextlib.nullcontext())
    monkeypatch.setattr(
        torch.cuda, "is_bf16_supported", lambda including_emulation: is_native | including_emulation
    )
    monkeypatch.setattr(torch.cuda, "get_device_capability", lambda device: capability)
    monkeypatch.setattr(torch.cuda, "get_device_name", lambda device: "NVIDIA RTX")
    found = emulation_reason("cuda:0")
    assert found.startswith(reason)
    assert bool(found) == bool(reason)
    require_half("cuda:0")  # runs in float16, which no card emulates
    text = f"--half runs in float16; train --bf16: {found or 'native bfloat16'}"
    assert describe_half("cuda:0") == text


def test_half_precision_is_float16_on_a_gpu_and_bfloat16_on_a_processor():
    assert half_dtype(torch.device("cuda", 1)) == torch.float16
    assert half_dtype("cpu") == torch.bfloat16


@pytest.mark.parametrize("command", ["run", pytest.param("images", marks=pytest.mark.app("view"))])
def test_emulated_bfloat16_is_refused_before_anything_is_rendered(
    command, use_processor, clip_folder, tmp_path
):
    use_processor("Skylake-SP")
    out = ("--out", tmp_path / "r")
    output = rlbench(command, "-m", "ours/A2", "--half", "--device", "cpu", *out, code=2)
    assert output.startswith(f"error: --half on device cpu: {EMULATES}")
    assert "Run without --half" in output
    with pytest.raises(OptionError, match=EMULATES):
        api.run(["ours/A2"], half=True, device="cpu", out=tmp_path / "r")
    assert not (tmp_path / "r").exists()
    assert not (tmp_path / "cache" / "clips").exists()


def test_a_worker_that_emulates_bfloat16_gives_the_reason_instead_of_a_time(
    use_processor, clip_folder, tmp_path
):
    use_processor("Zen 3")
    plan = half_plan(clip_folder, "ours/A2")
    assert measure(plan, tmp_path / "r").failed == 1
    assert EMULATES in read_cells(plan, tmp_path / "r")["note"].iloc[0]


def test_half_is_not_refused_where_nothing_runs_in_it(use_processor, clip_folder, tmp_path):
    use_processor("Zen 3")
    words = ("run", "-m", "mean", "--clips", clip_folder, "--spp", 1, "--times", "none")
    rlbench(*words, "--half", "--out", tmp_path / "r")


def test_training_in_emulated_bfloat16_is_warned_of(use_processor, tmp_path):
    use_processor("Zen 3")
    words = ("train", "-m", "ours/A2", "--bf16", "--device", "cpu", "--out", tmp_path / "runs")
    output = rlbench(*words, "--quick", "--seeds", 7, code=2)  # --quick has clips of its own
    assert f"warning: {EMULATES}; training is faster without --bf16" in output


def test_doctor_says_what_the_processor_can(use_processor):
    for name, text in (("Zen 4", "bfloat16 by avx512_bf16"), ("Zen 3", "--half is refused")):
        use_processor(name)
        found = {result.check: result.found for result in inspect_machine()}
        assert text in found["processor half precision"]
