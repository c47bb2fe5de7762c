"""The command video: kept images as MP4 and animated WebP."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rlbench.cli import arguments, options
from rlbench.cli.arguments import Crop

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["video"]

NAME = "images"  # of the writer, among the entry points
PICTURE = "Picture"  # titles of groups of options
PLAYBACK = "Playback"


def video(
    results: Annotated[
        Path, typer.Argument(metavar="RESULTS", help="folder of rlbench run", file_okay=False)
    ] = Path("results"),
    methods: options.RowMethods = None,
    scenes: options.RowScenes = None,
    clips: options.Clips = None,
    spp: options.ShownBudgets = None,
    layout: Annotated[
        str,
        typer.Option(
            metavar="LAYOUT",
            help="side-by-side, or wipe: two images behind a moving divider",
            rich_help_panel=PICTURE,
        ),
    ] = "side-by-side",
    reference: Annotated[
        bool,
        typer.Option("--reference", help="show the reference too", rich_help_panel=PICTURE),
    ] = False,
    samples: Annotated[
        bool,
        typer.Option("--samples", help="show where adaptive rows sampled", rich_help_panel=PICTURE),
    ] = False,
    line: Annotated[
        int | None,
        typer.Option(
            "--slice",
            min=0,
            metavar="Y",
            help="show line Y through time below each image",
            rich_help_panel=PICTURE,
        ),
    ] = None,
    zoom: Annotated[
        int, typer.Option(min=1, help="size of a pixel, in pixels", rich_help_panel=PICTURE)
    ] = 2,
    crop: Annotated[
        Crop | None,
        typer.Option(
            parser=arguments.parse_crop,
            metavar="X,Y,W,H",
            help="part of the frame, in pixels; default: all",
            rich_help_panel=PICTURE,
        ),
    ] = None,
    columns: Annotated[
        int | None,
        typer.Option(min=1, help="images in a line; default: all", rich_help_panel=PICTURE),
    ] = None,
    labels: Annotated[
        bool,
        typer.Option(
            "--labels/--no-labels",
            help="row, spp and PSNR of the frame above each image",
            rich_help_panel=PICTURE,
        ),
    ] = True,
    titles: Annotated[
        list[str] | None,
        typer.Option(
            metavar="A,B",
            help="titles instead of the names of rows, in their order",
            rich_help_panel=PICTURE,
        ),
    ] = None,
    fps: Annotated[
        float,
        typer.Option(
            parser=arguments.parse_positive,
            metavar="FPS",
            help="frames of the clip in a second",
            rich_help_panel=PLAYBACK,
        ),
    ] = 8.0,
    ping_pong: Annotated[
        bool,
        typer.Option("--ping-pong", help="forwards, then backwards", rich_help_panel=PLAYBACK),
    ] = False,
    repeat: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="times an MP4 plays; default: until 4 s have passed; a WebP plays for ever",
            rich_help_panel=PLAYBACK,
        ),
    ] = None,
    formats: Annotated[
        list[str] | None,
        typer.Option(
            "--format",
            metavar="NAMES",
            help="webp, mp4 or both; mp4 needs the extra video; default: webp",
            rich_help_panel=options.OUTPUT,
        ),
    ] = None,
    quality: Annotated[
        int,
        typer.Option(min=0, max=100, help="of WebP", rich_help_panel=options.OUTPUT),
    ] = 90,
    out: Annotated[
        Path | None,
        typer.Option(
            file_okay=False,
            metavar="FOLDER",
            help="folder to write to; default: RESULTS/video",
            rich_help_panel=options.OUTPUT,
        ),
    ] = None,
) -> None:
    """Write videos of kept images, one for each clip and budget.

    Images are those of `rlbench run --keep-images`, in clipped sRGB.

    Examples:

    \b
      rlbench video results -m mean,oidn,ours --reference --zoom 3
      rlbench video results -m ours,ntas --layout wipe --scenes city --format mp4,webp
      rlbench video results -m ours,ours/A2 --samples --slice 96 --ping-pong
    """
    from rlbench import registry
    from rlbench.benchmark.cell_images import find_all_images
    from rlbench.benchmark.results import read
    from rlbench.benchmark.shown_clips import display_clips, find_shown_clips
    from rlbench.cli import console
    from rlbench.cli.decide import select_scenes
    from rlbench.cli.view import find_sources, nearest_to_one
    from rlbench.system.paths import check_writable

    target = out or results / "video"
    check_writable(target)
    module = registry.load_or_explain("videos", NAME)
    suffixes = arguments.split_names(formats) or ["webp"]
    module.check_formats(suffixes)
    style = module.VideoStyle(
        layout=layout,
        zoom=zoom,
        fps=fps,
        ping_pong=ping_pong,
        repeat=repeat,
        crop=crop,
        line=line,
        samples=samples,
        labels=labels,
        titles=tuple(arguments.split_names(titles)),
        columns=columns,
        quality=quality,
    )
    rows = read(results)
    if names := arguments.split_names(scenes):
        rows = select_scenes(rows, names, results)
    names = _order_methods(rows, arguments.split_names(methods), results)
    budgets = spp or (nearest_to_one(set(rows["target_spp"])),)
    own_clips = set(rows.loc[rows["method"].isin(names), "clip"])
    kept = find_all_images(results, names, own_clips, budgets)
    for images in {each.cell.key.clip: each for each in kept}.values():
        _, height, width = images.frame(0).image.shape
        style.check(len(names), reference, height, width)
    shown_clips = find_shown_clips(results, find_sources(kept, clips), names, budgets, buffers=())
    lengths = [max(map(len, images)) for _, images in shown_clips.kept]
    per_clip = [style.pictures_written(length, suffixes) for length in lengths]
    with console.counting("pictures", len(budgets) * sum(per_clip)) as on_picture:
        files = [
            file
            for clip in shown_clips
            for each in display_clips(clip, names, budgets, rows, reference)
            for file in module.write(each, target, suffixes, style, on_picture)
        ]
    for file in files:
        typer.echo(file)


def _order_methods(rows: pd.DataFrame, names: list[str], results: Path) -> list[str]:
    """The rows that `names` select, in their order; without names all, those with least PSNR first.

    Raises OptionError for a name without rows.
    """
    from rlbench.cli.reports import select_rows

    if names:
        selected = (sorted(set(select_rows(rows, [name], results)["method"])) for name in names)
        return list(dict.fromkeys(method for group in selected for method in group))
    scores = rows[rows["metric"] == "psnr"].groupby("method")["value"].mean()
    return [str(method) for method in scores.sort_values().index]
