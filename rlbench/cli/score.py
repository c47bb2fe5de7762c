"""The command score: images made elsewhere become rows of the results."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from rlbench.cli import options
from rlbench.cli.arguments import split_names
from rlbench.cli.options import MEASUREMENT, flag, number, option
from rlbench.errors import OptionError


def score(
    name: Annotated[str, typer.Argument(metavar="NAME", help="name of the rows, such as nrd")],
    folder: Annotated[
        Path,
        typer.Argument(
            metavar="FOLDER",
            file_okay=False,
            help="a folder of images for each clip, named as the clip; of one clip, its images",
        ),
    ],
    spp: Annotated[
        float,
        number(MEASUREMENT, "samples per pixel that each image was made of", "SPP"),
    ],
    clips: options.Clips = None,
    scenes: options.Scenes = None,
    ms: Annotated[
        float | None,
        number(
            MEASUREMENT,
            "claimed time of a frame without its samples; without it, no rank by time",
            "MS",
        ),
    ] = None,
    device: Annotated[
        str,
        option(
            MEASUREMENT,
            "that --ms was measured on; default: the device of the other rows",
            value="NAME",
        ),
    ] = "",
    samples: Annotated[
        Path | None,
        option(
            MEASUREMENT,
            "samples of each pixel, EXR or NPY, in folders as FOLDER; checked against --spp",
            value="FOLDER",
            file_okay=False,
        ),
    ] = None,
    exposed: Annotated[
        bool,
        flag(
            MEASUREMENT,
            "--exposed",
            "display white is 1 in the EXR or PFM files, as in kept images of rlbench run",
        ),
    ] = False,
    out: options.Results = Path("results"),
    preset: options.Preset = "mini",
    takes: options.Takes = None,
) -> None:
    """Score images made elsewhere, and add them as rows.

    One image a frame, at the size of the clip, numbered in its names: EXR or PFM with the linear
    radiance of the clip's files (rlbench export writes what a denoiser reads), or PNG, 8-bit sRGB
    after the clip's exposure. Budget and time are what you claim, and each row says so. Rows that
    are there already, of the same images, stay.

    Examples:

    \b
      rlbench score nrd nrd_out/ --spp 1 --clips clips/ --ms 2.1 --device "RTX 4090"
      rlbench score engine frames/ --spp 1 --clips clips/bistro
      rlbench score theirs theirs/ --spp 2 --samples their_counts/ --preset real
    """
    from rlbench.benchmark.api import select_clips
    from rlbench.benchmark.foreign_images import (
        Claim,
        check_budget,
        check_name,
        find_foreign_images,
        score_foreign_images,
    )
    from rlbench.cli import console
    from rlbench.system.paths import check_writable

    if device and ms is None:
        raise OptionError(f"--device {device}: there is no time of it; add --ms, or omit it")
    check_name(name)
    check_writable(out)
    sources = select_clips(clips, split_names(scenes), preset, takes)
    found = find_foreign_images(folder, sources, samples)
    claim = Claim(name, spp, ms, device, exposed)
    check_budget(spp, sources)
    with console.counting("scoring images", sum(len(each.images) for each in found)) as advance:
        scored = score_foreign_images(claim, found, out, advance)
    for each in scored:
        status = ", was scored before" * each.is_cached
        typer.echo(f"{name} on {each.name} at {spp:g} spp: PSNR {each.psnr:.2f} dB{status}")
        for remark in each.remarks:
            typer.echo(f"  note: {remark}")
    timed = "" if ms else "; without --ms it is not ranked by time"
    typer.echo(f"not verified: images, budget and time are as claimed{timed}. Rows are in {out}")
