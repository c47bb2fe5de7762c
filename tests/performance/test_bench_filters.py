"""Classical filters at 720 x 720 against plain versions of them: pytest --benchmark-only."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import kornia
import pytest
import torch
from torch import Tensor

from baselines.eaw.method import Config, Eaw, atrous_pass
from baselines.svgf.method import BASE, LOG2E, Edges, atrous_filter, build, depth_gradient
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import Frame, Samples, Size
from rlbench.ops.padded_rows import PaddedRows
from tests.performance import plain_filters

SIDE = 720
WIDTHS = (Config.phi_color, Config.phi_normal, Config.phi_depth)


@pytest.fixture(scope="module")
def frame() -> Frame:
    """A frame of the procedural world with one sample per pixel."""
    return procedural_clip(1, Size(1, SIDE, SIDE), frames=2, pool_spp=1).frames[1]


@pytest.mark.parametrize("name", ["ours", "plain"])
@pytest.mark.benchmark(group="SVGF, five passes, 720x720")
def test_passes_of_svgf(benchmark: Any, frame: Frame, name: str) -> None:
    light, normal, depth = _guides(frame)
    variance, slope = light[:, :1].square(), depth_gradient(depth, depth > 0)
    rows = PaddedRows(1, SIDE, SIDE, margin=32)
    light_row, variance_row = rows.pack(light), rows.pack(variance)
    edges = Edges(rows.pack(normal), rows.pack(depth), rows.pack(-LOG2E / slope))
    filters: dict[str, Callable[[], Tensor]] = {
        "ours": lambda: rows.unpack(atrous_filter(rows, edges, light_row, variance_row, BASE)[0]),
        "plain": lambda: plain_filters.svgf_passes(light, variance, normal, depth, slope),
    }
    _assert_nearly_equal(_timed(benchmark, filters[name]), filters["plain"]())


@pytest.mark.parametrize("name", ["ours", "plain"])
@pytest.mark.benchmark(group="EAW, one pass, 720x720")
def test_pass_of_eaw(benchmark: Any, frame: Frame, name: str) -> None:
    light, normal, depth = _guides(frame)
    rows = PaddedRows(1, SIDE, SIDE, margin=32)
    row, scales = rows.pack(light), [(LOG2E / width) ** 0.5 for width in WIDTHS]
    guides = (light.log1p() * scales[0], normal * scales[1], depth.log() * scales[2])
    guide = torch.cat([rows.pack(image, 1e4) for image in guides])
    filters: dict[str, Callable[[], Tensor]] = {
        "ours": lambda: rows.unpack(atrous_pass(rows, 1, guide, row)),
        "plain": lambda: plain_filters.eaw_pass(light, normal, depth, 1, WIDTHS),
    }
    _assert_nearly_equal(_timed(benchmark, filters[name]), filters["plain"]())


@pytest.mark.benchmark(group="EAW, one pass, 720x720")
def test_pass_of_kornia(benchmark: Any, frame: Frame) -> None:
    """Kornia's joint bilateral filter of 5 x 5 pixels, guided by normals alone."""
    light, normal, _ = _guides(frame)
    image = _timed(
        benchmark,
        lambda: kornia.filters.joint_bilateral_blur(light, normal, 5, 0.3, (1.0, 1.0)),
    )
    assert image.shape == light.shape


@pytest.mark.parametrize("name", ["svgf", "eaw"])
@pytest.mark.benchmark(group="classical filters, whole frame, 720x720")
def test_frame(benchmark: Any, frame: Frame, name: str) -> None:
    method = build("", torch.device("cpu"), None) if name == "svgf" else Eaw()
    counts = torch.ones(1, 1, SIDE, SIDE, dtype=torch.int64)
    samples = Samples(frame.pool.read(frame.pool.empty(), counts), counts)
    gbuffer = frame.gbuffer.select(method.traits.inputs)
    with torch.inference_mode():
        _, state = method.denoise(gbuffer, samples, method.start(Size(1, SIDE, SIDE)))
    image = _timed(benchmark, lambda: method.denoise(gbuffer, samples, state)[0])
    assert torch.isfinite(image).all()


def _guides(frame: Frame) -> tuple[Tensor, Tensor, Tensor]:
    """Irradiance, normal and depth, with the sky replaced by a wall."""
    gbuffer = frame.gbuffer
    radiance = frame.pool.read(frame.pool.empty(), torch.ones(1, 1, SIDE, SIDE, dtype=torch.int64))
    sky = gbuffer.depth.isinf()
    forward = torch.tensor([0.0, -1.0, 0.0]).view(1, 3, 1, 1)
    normal = torch.where(sky, forward, gbuffer.normal)
    return radiance[:, 0], normal, torch.where(sky, 100.0, gbuffer.depth)


def _timed(benchmark: Any, run: Callable[[], Tensor]) -> Tensor:
    with torch.inference_mode():
        image: Tensor = benchmark.pedantic(run, rounds=3, warmup_rounds=1)
    return image


def _assert_nearly_equal(image: Tensor, expected: Tensor) -> None:
    """Equal in all but a few pixels: plain `exp` and powers of 2 differ in their last bit."""
    different = (image - expected).abs() > 1e-3 * expected.abs() + 1e-4
    assert float(different.float().mean()) < 1e-3
