"""The command import: frames of another renderer become clips."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rlbench.cli.options import number, option
from rlbench.errors import OptionError

if TYPE_CHECKING:
    from rlbench.apps.dumps.importers.sequence import ImportedSequence


def import_(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="SOURCE", exists=True, file_okay=False, help="folder of rendered frames"
        ),
    ],
    out: Annotated[
        Path, option(None, "parent folder of the clips", value="FOLDER", file_okay=False)
    ],
    layout: Annotated[
        str,
        option(
            None,
            "falcor, unreal, blender, mitsuba, nrd-sample, oidn, noisebase, rl-path-tracing "
            "or a TOML file",
            "--layout",
            "--format",
            value="NAME|FILE",
        ),
    ] = "",
    frames: Annotated[
        str | None, option(None, "frames before END; default: all", value="FIRST:END")
    ] = None,
    samples: Annotated[
        int | None, option(None, "samples per pixel; default: all, up to 64", min=1, max=64)
    ] = None,
    exposure: Annotated[
        float | None,
        number(
            None,
            "radiance times this is 1 at display white; default: chosen as in render FILE",
            "FACTOR",
        ),
    ] = None,
    sanitize: Annotated[
        bool,
        typer.Option(
            "--sanitize",
            help="repair NaN, infinite and negative values as in a run, and count them",
        ),
    ] = False,
    layer: Annotated[
        str,
        typer.Option(metavar="NAME", help="layer to read where files have several, as Blender's"),
    ] = "",
) -> None:
    """Turn frames of another renderer into clips.

    A layout says which files and channels hold which image, and in which convention; rlbench lint
    --guess SOURCE writes one. What a source lacks (motion, depth, halves of the reference, ...) is
    replaced, printed and stored in clip.toml. Files that are left out are listed, with the reason.
    A killed import resumes. --exposure also changes that of a finished one. Nothing is unpickled,
    no link out of SOURCE is followed, and images may have up to 8192 x 8192 pixels.

    Examples:

    \b
      rlbench import dump/ --layout engine.toml --out clips/
      rlbench import captures/ --layout falcor --out clips/ && rlbench lint clips/
      rlbench import sampleset_v1/test8/bistro1 --layout noisebase --frames 0:20 --out clips/
      rlbench import my_renders/ --layout oidn --out clips/ && rlbench run -m mean --clips clips/
    """
    from rlbench.apps.dumps.importers import writer
    from rlbench.apps.dumps.importers.formats import describe_left_out, find_sequences
    from rlbench.apps.dumps.importers.sequence import parse_frame_range
    from rlbench.cli import console
    from rlbench.system.paths import check_writable

    if not layout:
        raise OptionError(
            f"--layout is missing: rlbench lint --guess {source} writes one for these files. Ready "
            "ones are falcor, unreal, blender, mitsuba, nrd-sample, oidn, noisebase and "
            "rl-path-tracing"
        )
    check_writable(out)
    frame_range = parse_frame_range(frames) if frames else None
    clips = [
        (sequence, writer.clip_header(sequence, samples, exposure or 1.0), out / sequence.name)
        for sequence in find_sequences(source, layout, frame_range, layer)
    ]
    missing = [clip for clip in clips if not writer.is_finished(*clip)]
    findings: dict[Path, list[str]] = {}
    with console.counting("importing", sum(header.frames for _, header, _ in missing)) as on_frame:
        for sequence, header, folder in missing:
            factor = exposure or writer.estimate_exposure(sequence, sanitize)
            exposed = replace(header, exposure=factor)
            found = writer.write_clip(sequence, exposed, folder, on_frame, sanitize)
            findings[folder] = found.lines()
    for clip in clips:
        sequence, _, folder = clip
        status = "imported" if clip in missing else "was imported before"
        if exposure and clip not in missing:
            before = writer.change_exposure(sequence, folder, exposure, sanitize)
            status += f", its exposure {before:g} is replaced" if before != exposure else ""
        _print_clip(sequence, folder, status, findings.get(folder, []))
    drawn = [(sequence, header.pool_spp) for sequence, header, _ in clips]
    for line in describe_left_out(source, layout, drawn, frame_range):
        typer.echo(line)


def _print_clip(sequence: ImportedSequence, folder: Path, status: str, findings: list[str]) -> None:
    """Print size, findings, limitations and compatible methods of an imported clip."""
    from rlbench.clips.compatibility import compatibility_summary
    from rlbench.clips.header import LIMITATIONS, read_header

    header = read_header(folder)
    size = f"{header.frames} frames of {header.width} x {header.height} pixels"
    typer.echo(
        f"{folder}: {status}, {size}, {header.pool_spp} samples per pixel, exposure "
        f"{header.exposure:g}"
    )
    for note in (*sequence.notes, *findings):
        typer.echo(f"  note: {note}")
    for limitation in header.limitations:
        typer.echo(f"  limitation {limitation}: {LIMITATIONS[limitation]}")
    typer.echo(f"  {compatibility_summary(header)}")
