"""A real submission: two methods on two small clips, one of them with times."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import pytest
import torch

from rlbench.benchmark.clip_sources import StoredSource
from rlbench.benchmark.results import read
from rlbench.benchmark.run_plan import RunPlan
from rlbench.benchmark.runner import measure
from rlbench.benchmark.submission.collect import collect_submission
from rlbench.benchmark.submission.document import Submission, write_submission
from rlbench.system import provenance
from tests.conftest import write_noise

CEILING = 55.0  # dB; the noise of the half references of `write_noise`, by far below that of mean


class Submitted(NamedTuple):
    submission: Submission
    clips: dict[str, StoredSource]
    results: Path


@pytest.fixture(scope="session")
def submitted(tmp_path_factory) -> Submitted:
    folder = tmp_path_factory.mktemp("submission")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RLBENCH_CACHE", str(folder / "cache"))
        torch.set_num_threads(1)
        header = {"noise_ceiling_db": (CEILING,) * 3, "device": provenance.machine().name}
        clips = {
            name: StoredSource(write_noise(folder / "clips" / name, name, **header))
            for name in ("foyer", "attic")
        }
        plan = RunPlan(("mean",), tuple(clips.values()), (0.5, 2.0), repeats=1)
        measure(plan, folder / "results")
        scored = RunPlan(("svgf",), tuple(clips.values()), (0.5, 2.0))
        measure(scored, folder / "results", scores_only=True)
        results = read(folder / "results")
        submission = collect_submission(results, folder / "results", clips, contact="nobody")
        return Submitted(
            write_submission(submission, folder / "a.rlbench.json"), clips, folder / "results"
        )
