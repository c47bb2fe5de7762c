"""`rlbench import`: frames that others rendered become clips, and it says what they lack."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from rlbench.clips.header import Header


def import_(
    source: Annotated[Path, typer.Argument(help="folder of frames that others rendered")],
    format_: Annotated[str, typer.Option("--format", help="oidn, noisebase, or paper")],
    out: Annotated[Path, typer.Option(help="folder to which each clip's folder goes")],
    frames: Annotated[
        str | None, typer.Option(help="FIRST:END, END excluded; default every frame")
    ] = None,
    samples: Annotated[
        int | None, typer.Option(min=1, max=64, help="of each pixel; default all, up to 64")
    ] = None,
    exposure: Annotated[float, typer.Option(help="makes radiance 1.0 at display white")] = 1.0,
) -> None:
    """Turn frames that others rendered into clips; an import that was killed goes on.

    What a source lacks (halves of the reference, motion, ...) is said here and in clip.toml.
    Nothing is unpickled, no link out of SOURCE is followed, images are read up to 8192 x 8192.

    Examples:

      rlbench import sampleset_v1/test8/bistro1 --format noisebase --frames 0:20 --out clips/

      rlbench import my_renders/ --format oidn --out clips/ && rlbench run -m mean --clips clips/
    """
    from rlbench.clips.importers import formats, writer
    from rlbench.clips.importers.sequence import parse_frame_range

    found = formats.find_sequences(source, format_, parse_frame_range(frames) if frames else None)
    plans = [(each, writer.clip_header(each, samples, exposure), out / each.name) for each in found]
    todo = [plan for plan in plans if not writer.is_finished(*plan)]
    with _bar(sum(header.frames for _, header, _ in todo)) as tell:
        for plan in todo:
            writer.write_clip(*plan, tell)
    for plan in plans:
        _tell(*plan[1:], news="imported" if plan in todo else "known before")


@contextmanager
def _bar(frames: int) -> Iterator[Callable[[], None]]:
    """A bar over frames, on the error stream."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeRemainingColumn

    columns = ("importing", BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task("", total=frames)
        yield lambda: bar.advance(task)


def _tell(header: Header, folder: Path, news: str) -> None:
    """What became of one clip, what it lacks of the format, and what can be measured on it."""
    from rlbench.clips.compatibility import compatibility_summary
    from rlbench.clips.header import LIMITATIONS

    size = f"{header.frames} frames of {header.width} x {header.height}"
    typer.echo(f"{folder}: {news}, {size}, of each pixel {header.pool_spp} samples of 1 spp")
    for word in header.limitations:
        typer.echo(f"  limitation {word}: {LIMITATIONS[word]}")
    typer.echo(f"  {compatibility_summary(header)}")
