"""Backends: other code runs the networks, and the images stay the same."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

import pytest
import torch
from torch import nn

from rlbench import backends, registry
from rlbench.backends import (
    BACKENDS,
    EAGER,
    applicable_backend,
    find_networks,
    select_backend,
    use_backend,
)
from rlbench.benchmark import results
from rlbench.benchmark.clip_sources import StoredSource
from rlbench.benchmark.results import OTHER_BACKENDS
from rlbench.benchmark.run_plan import RunPlan
from rlbench.benchmark.runner import measure
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.errors import OptionError
from rlbench.frames import Size
from rlbench.method import Method
from rlbench.ops.recording import CudaGraphs, can_record
from rlbench.ops.unet import FeatureUNet, UNet
from rlbench.ops.unet_widths import FAST_WIDTHS
from rlbench.recorded_method import find_refusal
from rlbench.run import run_clip
from rlbench.wrappers import HalfPrecision, MethodWrapper
from tests.conftest import write_plugin
from tests.tapes import Tapes

CUDA = torch.cuda.is_available()
CPU = torch.device("cpu")
LEARNED = [name for name in registry.expand(["all/*"]) if registry.get_variant(name).learned]
# variants of a family share their networks' layers
ALL_LEARNED = [pytest.param(name, marks=[pytest.mark.slow] * ("/" in name)) for name in LEARNED]
CLIP = procedural_clip(3, Size(1, 34, 50), 2, 8)


@dataclass(frozen=True)
class Compared(MethodWrapper[Method]):
    """A method beside the same one on another backend: both get the same inputs."""

    other: Method
    differences: list[float] = field(default_factory=list)

    def plan(self, gbuffer, samples, state):
        density = super().plan(gbuffer, samples, state)
        self._compare(density, self.other.plan(gbuffer, samples, state))
        return density

    def denoise(self, gbuffer, samples, state):
        image, after = super().denoise(gbuffer, samples, state)
        self._compare(image, self.other.denoise(gbuffer, samples, state)[0])
        return image, after

    def _compare(self, first, second):
        assert second.dtype == torch.float32
        self.differences.append(float((first - second).abs().max() / first.abs().max()))


def differences(name: str, backend: str, bf16: bool = False) -> list[float]:
    """Largest differences of densities and images, relative to the largest value."""
    plain, other = (registry.load_method(name, CPU, "random") for _ in range(2))
    use_backend(other, backend, CPU, bf16)
    compared = Compared(plain, HalfPrecision(other, CPU, torch.bfloat16) if bf16 else other)
    list(run_clip(compared, CLIP, 2.0))
    return compared.differences


@pytest.mark.parametrize("name", [*ALL_LEARNED, "ours/latent", "ntas/direct"])
def test_openvino_changes_densities_and_images_by_rounding_only(name):
    """Sums of convolutions in another order: 2e-6 seen; history repairs may enlarge it."""
    assert max(differences(name, "openvino")) < 1e-4


@pytest.mark.parametrize("name", ["oidn", "ours"])
def test_openvino_in_bfloat16_changes_images_by_its_significand(name, native_bf16):
    """By as much as PyTorch's own bfloat16, up to a factor of two: layers round at other places."""
    by_torch = max(differences(name, EAGER, bf16=True))
    assert max(differences(name, "openvino", bf16=True)) < 2 * by_torch


@pytest.mark.slow
@pytest.mark.parametrize("name", ["oidn", "ours", "ntas"])
def test_compile_changes_densities_and_images_by_rounding_only(name):
    assert max(differences(name, "compile")) < 1e-4


def test_eager_leaves_a_method_as_it_is():
    assert differences("ours", EAGER) == [0.0] * 4


def test_networks_are_found_once_in_methods_and_in_wrapped_methods():
    def kinds(name: str) -> list[str]:
        return [type(net).__name__ for net in find_networks(registry.load_method(name, CPU))]

    assert kinds("ours") == ["Sampler", "UNet"]  # the sampler is also an attribute
    assert kinds("ours/latent") == ["Sampler", "Encoder", "UNet"]
    assert kinds("oidn/half") == ["UNet"]
    assert kinds("ntas") == ["Sampler", "FeatureUNet"]  # kernels are applied outside
    assert kinds("imcd") == ["UNet"]  # its encoder branches on values
    assert kinds("mean") == []


def test_outputs_are_not_overwritten_by_the_next_call_and_sizes_may_change():
    torch.manual_seed(0)
    network = UNet(3, widths=FAST_WIDTHS).eval()
    features = FeatureUNet(3, widths=FAST_WIDTHS).eval()
    images = [torch.rand(1, 3, *size) for size in ((16, 32), (32, 16), (16, 32))]
    with torch.inference_mode():
        expected = [network(image) for image in images]
        forward = backends.OpenVinoForward(network)
        found = [forward(image) for image in images]
        for ours, torchs in zip(found, expected, strict=True):
            torch.testing.assert_close(ours, torchs, rtol=1e-4, atol=1e-6)
        levels = backends.OpenVinoForward(features)(images[0])
        for ours, torchs in zip(levels, features(images[0]), strict=True):
            torch.testing.assert_close(ours, torchs, rtol=1e-4, atol=1e-6)


def test_rows_are_named_by_the_backend_and_scores_are_those_of_eager(clip_folder, tmp_path: Path):
    clips = (StoredSource(clip_folder),)
    for backend in (EAGER, "openvino"):
        plan = RunPlan(("oidn", "mean"), clips, (2.0,), backend=backend, limit_frames=2, repeats=1)
        measure(plan, tmp_path / "out")
    rows = results.read(tmp_path / "out")
    psnr = rows[(rows.metric == "psnr") & (rows.frame == 1)].set_index("method").value
    assert sorted(psnr.index) == ["mean", "oidn", "oidn@openvino"]
    assert psnr["oidn@openvino"] == pytest.approx(psnr["oidn"], abs=1e-3)


def test_auto_is_openvino_where_it_is_installed(monkeypatch: pytest.MonkeyPatch):
    assert select_backend("auto", CPU) == "openvino"
    monkeypatch.setattr(backends, "find_spec", lambda name: None)
    assert select_backend("auto", CPU) == EAGER
    with pytest.raises(OptionError, match=r"pip install 'rlbench\[openvino\]'"):
        select_backend("openvino", CPU)


class Forgetful(Tapes):
    """A recorder whose recordings do nothing."""

    def record(self, function):
        return (lambda: None), super().record(function)[1]


@pytest.mark.parametrize(
    ("recorder", "device", "expected"),
    [(Tapes, "cpu", True), (Forgetful, "cpu", False), (CudaGraphs, "cuda", CUDA)],
)
def test_graphs_are_chosen_where_a_small_one_is_replayed(recorder, device, expected):
    assert can_record(recorder(), torch.device(device)) is expected
    if device == "cuda":
        assert select_backend("auto", torch.device(device)) == ("graph" if expected else EAGER)


@pytest.fixture
def asking(tmp_path, monkeypatch):
    """The backend `graph`, recorded on the processor, and a plugin that asks for a value."""
    monkeypatch.setitem(backends.RECORDED, "graph", Tapes)
    monkeypatch.setattr(backends, "require_backend", lambda name, device: None)
    body = "return samples.mean.clamp(max=float(samples.mean.max())), None"
    registry.use_plugin(write_plugin(tmp_path / "asking.py", "asking", body=body))


def test_a_method_that_asks_runs_eagerly_and_says_why(asking):
    plain = registry.load_method("asking", CPU)
    recorded = MethodWrapper(use_backend(plain, "graph", CPU))
    clip = procedural_clip(0, Size(1, 16, 16), frames=3)
    assert find_refusal(recorded) == ""
    pairs = zip(run_clip(plain, clip, 1.0), run_clip(recorded, clip, 1.0), strict=True)
    assert all(torch.equal(one.image, two.image) for one, two in pairs)
    assert re.search(r"^ran eagerly.*recorded: aten.item.*eager_reason", find_refusal(recorded))


def test_rows_of_a_method_that_asks_have_the_reason_as_their_note(asking, clip_folder, tmp_path):
    plan = RunPlan(("asking", "mean"), (StoredSource(clip_folder),), spp=(1.0,), backend="graph")
    measure(plan, tmp_path / "r")
    table = results.read(tmp_path / "r").set_index("method")
    scores = table[table["metric"] == "psnr"]
    assert scores.loc["asking@graph", "note"].str.startswith("ran eagerly").all()
    assert not scores.loc["mean@graph", "note"].astype(bool).any()


def test_a_backend_that_cannot_be_used_is_an_error_that_says_why():
    with pytest.raises(OptionError, match="no backend 'onnx'; available: auto, eager, openvino"):
        select_backend("onnx", CPU)
    with pytest.raises(OptionError, match="not on cuda; add --device cpu"):
        select_backend("openvino", torch.device("cuda"))
    for name in ("graph", "fused"):
        with pytest.raises(OptionError, match=f"{name} records CUDA graphs, and cannot run on cpu"):
            select_backend(name, CPU)


def test_graphs_run_every_row_that_can_be_recorded_and_compilers_those_with_networks():
    svgf, intel = (registry.get_variant(name) for name in ("svgf", "oidn-intel"))
    for name in ("graph", "fused"):
        chosen = [applicable_backend(name, variant) for variant in (svgf, intel)]
        assert chosen == [name, EAGER]
        assert applicable_backend(name, svgf, skips_tiles=True) == EAGER
    assert applicable_backend("openvino", svgf) == EAGER


def test_labels_of_rows_are_the_backends_names():
    assert set(OTHER_BACKENDS) == set(BACKENDS) - {EAGER}


def test_the_conversion_of_a_network_does_not_keep_it_from_pytorch():
    network = nn.Sequential(nn.Conv2d(3, 3, 3))
    forward = backends.OpenVinoForward(network)
    image = torch.rand(1, 3, 8, 8)
    with torch.inference_mode():
        assert torch.allclose(forward(image), forward._forward(image), atol=1e-6)
