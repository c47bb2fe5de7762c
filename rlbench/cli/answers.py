"""The questions that commands answer from results, as functions for Python."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rlbench.errors import OptionError, names_arguments

if TYPE_CHECKING:
    import pandas as pd

    from reports.compare import Comparison
    from reports.decide import Decision, GivenTimes

RESULTS = Path("results")


@names_arguments
def decide(
    frame_ms: float,
    sample_ms: float | None = None,
    rows: pd.DataFrame | None = None,
    *,
    folder: Path | str = RESULTS,
    gbuffer_ms: float | None = None,
    cost: str = "",
    metric: str = "psnr",
    device: str = "",
    strict: bool = False,
    left_out: Sequence[str] = (),
    plugins: str = "",
) -> Decision:
    """Which denoiser, at how many samples, has the least error in a frame of `frame_ms`.

    `sample_ms` is your renderer's time for one sample of every pixel, `gbuffer_ms` that of its
    G-buffer; by default it costs as many samples as in the results. `rows` are results as `run`
    returns them; by default those in `folder` are read. `cost` is a cost profile whose times of
    methods, if it has any, and of a sample replace those of the results. The answer has
    `candidates`, the best first. `strict`, `left_out` and `plugins` are as in `reports.decide`.
    Raises RlbenchError where no denoiser fits, or rows cannot be compared.
    """
    from reports.decide import decide as decide_rows
    from rlbench.benchmark.cost_profile import MEASURED
    from rlbench.benchmark.results import read

    table = read(Path(folder)) if rows is None else rows
    given = _read_times(cost, table) if cost not in ("", MEASURED) else None
    sample = sample_ms if sample_ms is not None else given.sample_ms if given else None
    if given and not given.inference_ms:  # a profile of a renderer: methods as measured
        given = None
    if sample is None:
        raise OptionError("--sample-ms or --cost is needed: what a sample of every pixel costs")
    return decide_rows(
        table,
        sample,
        frame_ms,
        metric,
        device,
        left_out,
        strict,
        gbuffer_ms,
        given,
        plugins,
    )


@names_arguments
def compare(
    first: str,
    second: str,
    rows: pd.DataFrame | None = None,
    *,
    folder: Path | str = RESULTS,
    metric: str = "psnr",
    device: str = "",
) -> Comparison:
    """Whether row `first` of the results leads row `second`, and how sure that is.

    `rows` are results as `run` returns them; by default those in `folder` are read. The answer has
    the paired difference of each budget with its interval. Raises RlbenchError for a row that the
    results do not have.
    """
    from reports.compare import compare as compare_rows
    from rlbench.benchmark.results import read
    from rlbench.cli.selection import select_methods

    table = read(Path(folder)) if rows is None else rows
    return compare_rows(
        select_methods(table, [first, second], Path(folder)), first, second, metric, device
    )


def _read_times(cost: str, rows: pd.DataFrame) -> GivenTimes:
    """The times of a cost profile at its own size, for the rows of the results."""
    from reports.decide import GivenTimes
    from rlbench.benchmark.cost_profile import read_profile

    times = read_profile(cost)
    found = {name: times.inference(name, times.height, times.width) for name in set(rows["method"])}
    inference = {name: each.ms for name, each in found.items() if each}
    size = f"{times.width}x{times.height}"
    return GivenTimes(times.device, size, times.source, times.default_ms, inference)
