"""The least time of a frame on a GPU: what its memory and its matrix units need, without any wait.

Command: python -m research.least_times accumulate/tuned,ours,svgf

Bytes are counted where every operation reads and writes memory by itself (backend `graph`), and
behind the fusion of torch.compile (`fused`); its loops are planned here for a processor, and not
compiled. Each stage is fused by itself, so what both reproject counts twice. No cache counts, so
small frames may be faster. What a frame takes at least is the larger of two times: of its bytes at
the card's bandwidth, and of its multiply-adds at the card's peak.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from unittest.mock import patch

import torch
from rich.progress import track
from torch import Tensor

from rlbench.benchmark.speed import COUNTED_SIDE, Configuration, count_work, generated_clip
from rlbench.method import Method
from rlbench.ops.recording import MOST_KINDS
from rlbench.run import run_frame
from rlbench.sanitize import sanitize_frame

CPU = torch.device("cpu")


@dataclass(frozen=True)
class Card:
    """Peaks of a GPU as its maker states them."""

    bandwidth: float  # bytes per second
    multiply_adds: float  # per second, of dense products in half precision


H100 = Card(3.35e12, 989e12 / 2)  # NVIDIA H100 SXM


@dataclass(frozen=True)
class FrameWork:
    """What a frame with history computes and moves, per pixel."""

    multiply_adds: float
    bytes_apart: float  # where each operation reads and writes for itself
    bytes_fused: float  # where torch.compile has fused the operations of each stage

    def least_ms(self, card: Card, pixels: int) -> tuple[float, float, float]:
        """Milliseconds of the bytes apart, of the bytes fused, and of the multiply-adds."""
        moved = (1e3 * each / card.bandwidth for each in (self.bytes_apart, self.bytes_fused))
        apart, fused = (pixels * each for each in moved)
        return apart, fused, 1e3 * pixels * self.multiply_adds / card.multiply_adds


class _PlannedError(Exception):
    """The loops are planned; nothing is compiled."""


@contextmanager
def _planning(total: list[int]) -> Iterator[None]:
    """Within it, torch.compile appends the bytes of its loops to `total`, and ends."""
    from torch._inductor.graph import GraphLowering

    def stop(graph: GraphLowering) -> None:
        graph.codegen()
        total.append(graph.count_bytes()[0])
        raise _PlannedError

    limits = {"recompile_limit": MOST_KINDS, "trace_autograd_ops": True}
    with (
        patch.object(GraphLowering, "compile_to_module", stop),
        torch._dynamo.config.patch(limits),
        torch._inductor.config.patch(fx_graph_cache=False),  # what is cached is not planned again
        torch._functorch.config.patch(enable_autograd_cache=False),
    ):
        yield


def count_fused_bytes(function: Callable[[], object]) -> int:
    """Bytes that the loops read and write which torch.compile makes of a function on a processor.

    Raises RuntimeError for a function that is not one graph.

    >>> a, b = torch.zeros(2, 1000)
    >>> count_fused_bytes(lambda: (a + b) * b - a)  # of 4 bytes: reads two, writes one
    12000
    """
    total: list[int] = []
    torch._dynamo.reset()
    with _planning(total), torch.no_grad():
        try:
            torch.compile(function, fullgraph=True, dynamic=False)()
        except Exception:
            if not total:
                raise
    return sum(total)


def measure_work(method: Method) -> FrameWork:
    """The work of the second frame of a small clip, stage by stage."""
    first, second = list(generated_clip((COUNTED_SIDE, COUNTED_SIDE), CPU))[:2]
    inputs, spp = method.traits.inputs, method.traits.nearest_spp(1.0)
    with torch.no_grad():
        before, frame = (sanitize_frame(each, inputs) for each in (first, second))
        _, _, state = run_frame(method, before, method.start(frame.pool.size), spp)
        samples, _, _ = run_frame(method, frame, state, spp)

        def plan() -> Tensor:
            return method.plan(frame.gbuffer, frame.pool.empty(), state)

        def denoise() -> object:
            return method.denoise(frame.gbuffer, samples, state)

        stages = (plan, denoise) if method.traits.adaptive else (denoise,)
        fused = sum(map(count_fused_bytes, stages)) / COUNTED_SIDE**2
    work = count_work(method, CPU)
    return FrameWork(work.multiply_adds, work.traffic_bytes, fused)


def tabulate(rows: dict[str, FrameWork], card: Card, size: tuple[int, int]) -> str:
    """A table in Markdown: work per pixel, and the least times at a size (width, height)."""
    title = "least ms, {} at {}x{}".format
    head = ["row", "kB a pixel, apart", "kB a pixel, fused", "thousand multiply-adds a pixel"]
    head += [title(each, *size) for each in ("apart", "fused", "networks")]
    lines = [head, ["---", *["---:"] * (len(head) - 1)]]
    for name, work in rows.items():
        per_pixel = (work.bytes_apart, work.bytes_fused, work.multiply_adds)
        numbers = (*(each / 1e3 for each in per_pixel), *work.least_ms(card, size[0] * size[1]))
        lines.append([f"`{name}`", *(f"{number:.1f}" for number in numbers)])
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)


def main(words: Sequence[str] | None = None) -> None:
    """Print the table of rows at 1920x1080 on an H100."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("methods", help="rows a,b")
    names = parser.parse_args(words).methods.split(",")
    rows = {n: measure_work(Configuration(n).load(CPU)) for n in track(names, "planning loops")}
    print(tabulate(rows, H100, (1920, 1080)))  # noqa: T201


if __name__ == "__main__":
    main()
