"""The command export: a clip's noisy input and buffers, for denoisers outside of this suite."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from rlbench.cli.options import flag, option


def export(
    clips: Annotated[
        list[Path], typer.Argument(metavar="CLIP...", help="clips, or folders of clips")
    ],
    to: Annotated[
        Literal["oidn", "nrd", "exr"],
        option(None, "what reads it: oidnDenoise, NRD, or anything that reads EXR", "--format"),
    ],
    out: Annotated[Path, option(None, "parent folder of a folder for each clip", value="FOLDER")],
    spp: Annotated[
        int, option(None, "samples of each pixel, whose mean is written", min=1, max=1024)
    ] = 1,
    seed: Annotated[int, option(None, "of the order of the samples, as in rlbench run")] = 0,
    reference: Annotated[
        bool, flag(None, "--reference", "also write the reference; never give it to a denoiser")
    ] = False,
) -> None:
    """Write noisy input and buffers of clips for another program.

    oidn: color, albedo and normal as PFM. nrd: the textures of NRD, demodulated. exr: one
    multilayer EXR a frame, with Blender's names. Radiance is linear, as in the clip's files. The
    conventions, and what a clip does not have, are printed and stored in export.toml. A killed
    export resumes.

    Examples:

    \b
      rlbench export clips/bistro --format oidn --out exported/
      rlbench export clips/ --format nrd --spp 2 --out nrd_in/
      rlbench score theirs theirs_out/ --spp 2 --clips clips/
    """
    from rlbench.apps.dumps.export import export_clip
    from rlbench.cli import console
    from rlbench.clips.header import read_header
    from rlbench.clips.stored import find_all_clips
    from rlbench.system.paths import check_writable

    check_writable(out)
    headers = {source: read_header(source) for source in find_all_clips(clips)}
    notes: dict[str, None] = {}
    with console.counting("exporting", sum(h.frames for h in headers.values())) as advance:
        for source, header in headers.items():
            found = export_clip(
                source, out / header.name, to, spp, seed, with_reference=reference, on_frame=advance
            )
            notes |= dict.fromkeys(found)
    for header in headers.values():
        typer.echo(f"{out / header.name}: {header.frames} frames, {spp} spp")
    for note in notes:
        typer.echo(f"  {note}")
    names = ",".join(header.name for header in headers.values())
    typer.echo(f"score the images: rlbench score NAME FOLDER --spp {spp} --clips ... ({names})")
