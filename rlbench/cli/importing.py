"""The command import: frames of another renderer become clips."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from rlbench.clips.header import Header

__all__ = ["import_"]


def import_(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="SOURCE", exists=True, file_okay=False, help="folder of rendered frames"
        ),
    ],
    format_: Annotated[
        str,
        typer.Option("--format", metavar="FORMAT", help="oidn, noisebase or rl-path-tracing"),
    ],
    out: Annotated[
        Path,
        typer.Option(file_okay=False, metavar="FOLDER", help="parent folder of the clips"),
    ],
    frames: Annotated[
        str | None,
        typer.Option(metavar="FIRST:END", help="frames before END; default: all"),
    ] = None,
    samples: Annotated[
        int | None, typer.Option(min=1, max=64, help="samples per pixel; default: all, up to 64")
    ] = None,
    exposure: Annotated[
        float, typer.Option(help="radiance times this is 1 at display white")
    ] = 1.0,
) -> None:
    """Turn frames of another renderer into clips.

    What a source lacks (halves of the reference, motion, ...) is printed and stored in clip.toml. A
    killed import resumes. Nothing is unpickled, no link out of SOURCE is followed, and images may
    have up to 8192 x 8192 pixels.

    Examples:

    \b
      rlbench import sampleset_v1/test8/bistro1 --format noisebase --frames 0:20 --out clips/
      rlbench import my_renders/ --format oidn --out clips/ && rlbench run -m mean --clips clips/
    """
    from rlbench.cli import console
    from rlbench.clips.importers import writer
    from rlbench.clips.importers.formats import find_sequences
    from rlbench.clips.importers.sequence import parse_frame_range

    frame_range = parse_frame_range(frames) if frames else None
    sequences = find_sequences(source, format_, frame_range)
    clips = [(s, writer.clip_header(s, samples, exposure), out / s.name) for s in sequences]
    missing = [clip for clip in clips if not writer.is_finished(*clip)]
    with console.counting("importing", sum(header.frames for _, header, _ in missing)) as on_frame:
        for clip in missing:
            writer.write_clip(*clip, on_frame)
    for clip in clips:
        _, header, folder = clip
        _print_clip(header, folder, "imported" if clip in missing else "was imported before")


def _print_clip(header: Header, folder: Path, status: str) -> None:
    """Print size, limitations and compatible methods of an imported clip."""
    from rlbench.clips.compatibility import compatibility_summary
    from rlbench.clips.header import LIMITATIONS

    size = f"{header.frames} frames of {header.width} x {header.height} pixels"
    typer.echo(f"{folder}: {status}, {size}, {header.pool_spp} samples per pixel")
    for limitation in header.limitations:
        typer.echo(f"  limitation {limitation}: {LIMITATIONS[limitation]}")
    typer.echo(f"  {compatibility_summary(header)}")
