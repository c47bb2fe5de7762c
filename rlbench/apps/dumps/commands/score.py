"""The command score: images made elsewhere become rows; or two files are compared."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rlbench.cli import options
from rlbench.cli.arguments import split_names
from rlbench.cli.config_file import refuse_typed
from rlbench.cli.list_ import FILE_WIDTH
from rlbench.cli.methods import load_plugins
from rlbench.cli.options import MEASUREMENT, flag, number, option
from rlbench.errors import OptionError

if TYPE_CHECKING:
    from rlbench.apps.dumps.foreign_images import Claim
    from rlbench.benchmark.clip_sources import StoredSource
    from rlbench.cli.json_output import FileScoresOutput

OF_FOLDERS = (
    "spp", "clips", "scenes", "ms", "device", "samples", "exposed", "out", "preset", "takes"
)  # fmt: skip
OF_FILES = ("metrics", "convention", "exposure", "layer", "plugin", "as_json")
FILES = "Of two files"  # title of a group of options


def score(
    context: typer.Context,
    name: Annotated[
        str, typer.Argument(metavar="NAME|IMAGE", help="name of the rows, such as nrd; or a file")
    ],
    folder: Annotated[
        Path,
        typer.Argument(
            metavar="FOLDER|REFERENCE",
            help="a folder of images for each clip, named as the clip; of one clip, its images; or "
            "the reference of the file IMAGE",
        ),
    ],
    spp: Annotated[
        float | None,
        number(MEASUREMENT, "of each image of a FOLDER, samples per pixel; required there", "SPP"),
    ] = None,
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
    metrics: Annotated[
        list[str] | None,
        option(
            FILES,
            "metrics a,b; default: those of rlbench run that two images have",
            value="NAMES",
            complete=options.complete_names("metrics"),
        ),
    ] = None,
    exposure: Annotated[
        float | None,
        number(FILES, "factor on EXR and PFM, after which display white is 1", "FACTOR"),
    ] = None,
    as_json: options.Json = False,
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
    convention: Annotated[
        str, option(FILES, "what PSNR and SSIM compare: srgb, linear, hable, ...", value="NAME")
    ] = "",
    layer: Annotated[
        str, option(FILES, "layer of EXR files that have several, as Blender's", value="NAME")
    ] = "",
    plugin: options.Plugins = None,
) -> None:
    """Score images made elsewhere as rows, or compare two files.

    With a FOLDER: one image a frame, at the size of the clip, numbered in its names: EXR or PFM
    with the linear radiance of the clip's files (rlbench export writes what a denoiser reads), or
    PNG, 8-bit sRGB after the clip's exposure. Budget and time are what you claim, and each row says
    so. Rows that are there already, of the same images, stay.

    With two files, EXR, PFM or PNG of one size, nothing is stored. EXR and PFM are linear radiance,
    of any chromaticities, and PNG is decoded.

    Examples:

    \b
      rlbench score denoised.exr reference.exr
      rlbench score denoised.exr reference.exr --metrics psnr,flip --exposure 0.5 --json
      rlbench score nrd nrd_out/ --spp 1 --clips clips/ --ms 2.1 --device "RTX 4090"
      rlbench score engine frames/ --spp 1 --clips clips/bistro
      rlbench score theirs theirs/ --spp 2 --samples their_counts/ --preset real
    """
    from rlbench.clips.linear_images import ENCODINGS

    if folder.is_file() or folder.suffix.lower() in ENCODINGS and not folder.is_dir():
        refuse_typed(context, OF_FOLDERS, "folders of images")
        load_plugins(plugin)
        pair = Path(name), folder
        _compare_files(*pair, split_names(metrics), convention, exposure, layer, as_json)
        return
    refuse_typed(context, OF_FILES, "two image files")
    if spp is None:
        raise OptionError(
            f"--spp is needed for a folder of images such as {folder}: samples per pixel that each "
            "was made of. Two files are compared without it: rlbench score IMAGE REFERENCE"
        )
    if device and ms is None:
        raise OptionError(f"--device {device}: there is no time of it; add --ms, or omit it")
    from rlbench.apps.dumps.foreign_images import Claim, check_name
    from rlbench.benchmark.planning import select_clips
    from rlbench.system.paths import check_writable

    check_name(name)
    check_writable(out)
    sources = select_clips(clips, split_names(scenes), preset, takes)
    _add_rows(Claim(name, spp, ms, device, exposed), folder, sources, samples, out)


def _add_rows(
    claim: Claim,
    folder: Path,
    sources: Sequence[StoredSource],
    samples: Path | None,
    out: Path,
) -> None:
    """Score the images in a folder as `claim` says, and print what became of each clip."""
    from rlbench.apps.dumps.foreign_images import (
        check_budget,
        find_foreign_images,
        score_foreign_images,
    )
    from rlbench.cli import console

    found = find_foreign_images(folder, sources, samples)
    check_budget(claim.spp, sources)
    with console.counting("scoring images", sum(len(each.images) for each in found)) as advance:
        scored = score_foreign_images(claim, found, out, advance)
    for each in scored:
        status = ", was scored before" * each.is_cached
        typer.echo(
            f"{claim.name} on {each.name} at {claim.spp:g} spp: PSNR {each.psnr:.2f} dB{status}"
        )
        for remark in each.remarks:
            typer.echo(f"  note: {remark}")
    timed = "" if claim.ms else "; without --ms it is not ranked by time"
    typer.echo(f"not verified: images, budget and time are as claimed{timed}. Rows are in {out}")


def _compare_files(
    image: Path,
    reference: Path,
    names: list[str],
    convention: str,
    exposure: float | None,
    layer: str,
    as_json: bool,
) -> None:
    """Print the metrics of an image file beside its reference."""
    from rlbench import metrics
    from rlbench.cli.json_output import FileScoresOutput, print_json
    from rlbench.clips.linear_images import ENCODINGS

    suffixes = sorted({image.suffix.lower(), reference.suffix.lower()})
    if exposure and ".png" in suffixes:
        raise OptionError("--exposure is for EXR and PFM, and a PNG is exposed already. Omit it")
    white = 1 / exposure if exposure else None
    scores = metrics.score(
        image, reference, names, data_range=white, convention=convention, layer=layer
    )
    rows = [
        {
            "metric": name,
            "value": scores[name],
            "unit": metric.unit,
            "better": metric.direction,
            "convention": metric.convention,
        }
        for name, metric in scores.metrics.items()
    ]
    remarks = []
    if len(suffixes) > 1 and ".png" in suffixes:
        remarks.append(f"files of two kinds: {'; '.join(ENCODINGS[each] for each in suffixes)}")
    if count := scores.get("nonfinite"):
        remarks.append(
            f"{image}: {count:g} pixels are NaN or infinite, and count as the largest error"
        )
    output = FileScoresOutput(str(image), str(reference), rows, remarks)
    if as_json:
        print_json(output)
    else:
        _print_scores(output)


def _print_scores(output: FileScoresOutput) -> None:
    """Print a table of metrics and the remarks."""
    from rich.console import Console
    from rich.table import Table

    table = Table(title=f"{output.image} beside {output.reference}", title_justify="left")
    for column in ("metric", "value", "unit", "better", "convention"):
        is_number = column == "value"
        table.add_column(
            column,
            justify="right" if is_number else "left",
            no_wrap=column != "convention",
            overflow="fold",
        )
    for row in output.scores:
        table.add_row(row["metric"], f"{row['value']:.5g}", *map(str, list(row.values())[2:]))
    console = Console(markup=False)
    if not console.is_terminal:  # into a file or a pager, which has no width to fit
        console = Console(markup=False, width=FILE_WIDTH)
    console.print(table)
    for remark in output.remarks:
        typer.echo(remark, err=True)
