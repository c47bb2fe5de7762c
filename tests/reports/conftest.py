"""Made-up but realistic results, from formulas whose means are known."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from reports.layout import style
from rlbench.benchmark.results import Row, to_dataframe

SCENES = {"city": 0.0, "temple": -2.0, "hall": -4.0, "ripples": 1.5}  # dB
SAMPLE_MS = {"city": 16.6, "temple": 17.6, "hall": 34.5, "ripples": 36.6}
BUDGETS = (0.5, 1.0, 2.0, 4.0, 8.0)
METHODS = {  # dB at 1 spp, dB a doubling, plan ms, denoise ms
    "mean": (17.0, 2.9, 0.0, 0.3),
    "oidn": (27.5, 1.25, 0.0, 9.0),
    "ntas": (28.6, 1.2, 6.5, 14.0),
    "ours": (29.9, 1.15, 5.5, 11.0),
    "ours/latent-small": (29.2, 1.1, 2.2, 4.5),
}
CLIPS, FRAMES = 2, 4
OFFSET = sum(SCENES.values()) / len(SCENES)


def psnr(method, scene, spp, clip=0, frame=0):
    """Deviations of frames and clips have mean zero; those of a clip depend on the method."""
    start, slope, _, _ = METHODS[method]
    by_method = 0.06 * (2 * clip - 1) * (1 + list(METHODS).index(method) % 2)
    deviation = 0.3 * math.cos(math.pi * frame) + 0.5 * (2 * clip - 1) + by_method
    return start + slope * math.log2(spp) + SCENES[scene] + deviation


def rows(methods=METHODS, device="NVIDIA RTX 2080 Ti", profile="profile paper-2080ti", **equal):
    """The rows with certain values of columns: `metric="psnr", target_spp=1`."""
    return [
        row
        for method in methods
        for scene in SCENES
        for spp in BUDGETS
        for clip in range(CLIPS)
        for row in _cell(method, scene, spp, clip, device, profile)
        if all(getattr(row, name) == value for name, value in equal.items())
    ]


def _cell(method, scene, spp, clip, device, profile):
    def row(frame, metric, value, unit, direction, convention):
        return Row(
            "r1", method, f"{scene}-{clip}", scene, spp, spp * 0.99, frame, metric, value, unit,
            direction, convention, device=device, dtype="float32", code_hash="c0de",
        )  # fmt: skip

    _, _, plan, denoise = METHODS[method]
    for frame in range(FRAMES):
        value = psnr(method, scene, spp, clip, frame)
        yield row(frame, "psnr", value, "dB", "higher", "peak 1, clipped sRGB")
        yield row(frame, "relmse", 10 ** (-value / 10), "", "lower", "linear radiance")
    times = {"gbuffer_ms": 0.0, "plan_ms": plan, "allocate_ms": 0.0, "denoise_ms": denoise}
    times |= {"sampling_ms": 0.99 * spp * SAMPLE_MS[scene]}
    times |= {"inference_p95_ms": 1.2 * (plan + denoise)}
    for metric, value in times.items():
        yield row(-1, metric, value, "ms", "lower", "p50 of 50")
    yield row(-1, "sample_ms", SAMPLE_MS[scene], "ms", "lower", profile)


def renamed(table, **names):
    """The rows of some methods under other names: `ours="mine"`."""
    return [replace(row, method=names.get(row.method, row.method)) for row in table]


def as_published(table):
    """The rows of `ours` under the name of the paper's method, which is `ours/latent`."""
    return renamed(table, ours="ours/latent")


def table_rows(page, title, start=""):
    """The cells of a Markdown table below a heading, row by row; not bold."""
    section = page[page.index(f"### {title}") :].split("\n###")[0]
    lines = [line for line in section.splitlines() if line.startswith(f"| {start}")]
    return [[cell.strip(" *") for cell in line.split("|")[1:-1]] for line in lines]


def cells(page, title, start):
    """The cells after the first of the row that starts so."""
    return table_rows(page, title, start)[0][1:]


@pytest.fixture(scope="session")
def results():
    return to_dataframe(rows())


@pytest.fixture(scope="session")
def published_results():
    """Every method is one of the paper's table."""
    return to_dataframe(as_published(rows()))


@pytest.fixture(autouse=True)
def _whole_fonts(monkeypatch):
    """Fonts in PDF files as outlines: their subsets take most of the time of a figure."""
    monkeypatch.setitem(style.RC, "pdf.fonttype", 3)
