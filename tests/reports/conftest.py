"""Made-up but realistic results, from formulas whose means are known."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

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


def psnr(method, scene, spp, clip=0, frame=0):
    """Deviations of frames and clips have mean zero; those of a clip depend on the method."""
    start, slope, _, _ = METHODS[method]
    by_method = 0.06 * (2 * clip - 1) * (1 + list(METHODS).index(method) % 2)
    deviation = 0.3 * math.cos(math.pi * frame) + 0.5 * (2 * clip - 1) + by_method
    return start + slope * math.log2(spp) + SCENES[scene] + deviation


def rows(methods=METHODS, device="NVIDIA RTX 2080 Ti", profile="profile paper-2080ti"):
    table = []
    for method in methods:
        for scene in SCENES:
            for spp in BUDGETS:
                for clip in range(CLIPS):
                    table += measured_cell(method, scene, spp, clip, device, profile)
    return table


def measured_cell(method, scene, spp, clip, device, profile):
    def row(frame, metric, value, unit, direction, convention):
        return Row(
            "r1", method, f"{scene}-{clip}", scene, spp, spp * 0.99, frame, metric, value, unit,
            direction, convention, device=device, dtype="float32", code_hash="c0de",
        )  # fmt: skip

    _, _, plan, denoise = METHODS[method]
    cell_rows = []
    for frame in range(FRAMES):
        value = psnr(method, scene, spp, clip, frame)
        cell_rows.append(row(frame, "psnr", value, "dB", "higher", "peak 1, clipped sRGB"))
        cell_rows.append(row(frame, "relmse", 10 ** (-value / 10), "", "lower", "linear radiance"))
    for metric, value in {
        "plan_ms": plan,
        "plan_p95_ms": plan * 1.1,
        "denoise_ms": denoise,
        "denoise_p95_ms": denoise * 1.2,
    }.items():
        cell_rows.append(row(-1, metric, value, "ms", "lower", "p50 of 50"))
    cell_rows.append(row(-1, "sample_ms", SAMPLE_MS[scene], "ms", "lower", profile))
    return cell_rows


def as_published(table):
    """The rows of `ours` under the name of the paper's method, which is `ours/latent`."""
    return [replace(row, method="ours/latent") if row.method == "ours" else row for row in table]


@pytest.fixture(scope="session")
def results():
    return to_dataframe(rows())


@pytest.fixture(scope="session")
def published_results():
    """Every method is one of the paper's table."""
    return to_dataframe(as_published(rows()))
