"""The command video: kept images as MP4 and animated WebP."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rlbench.api import select_methods
from rlbench.cli import options
from rlbench.cli.arguments import Crop, parse_crop, split_names
from rlbench.cli.options import OUTPUT, fill, flag, folder, number, option
from rlbench.cli.selection import find_sources, read_rows

if TYPE_CHECKING:
    import pandas as pd

PICTURE, PLAYBACK = "Picture", "Playback"  # titles of groups of options


def video(
    results: options.RunFolder = Path("results"),
    methods: options.RowMethods = None,
    scenes: options.RowScenes = None,
    spp: options.ShownBudgets = None,
    layout: Annotated[
        str,
        option(
            PICTURE, "side-by-side, or wipe: two images behind a moving divider", value="LAYOUT"
        ),
    ] = "side-by-side",
    reference: Annotated[bool, flag(PICTURE, "--reference", "show the reference too")] = False,
    zoom: Annotated[int, option(PICTURE, "size of a pixel, in pixels", min=1)] = 2,
    formats: Annotated[
        list[str] | None,
        option(
            OUTPUT,
            "webp, mp4 or both; mp4 needs the extra video; default: webp",
            "--format",
            value="NAMES",
        ),
    ] = None,
    out: Annotated[Path | None, folder("folder to write to; default: RESULTS/video")] = None,
    clips: options.Clips = None,
    samples: Annotated[
        bool, flag(PICTURE, "--samples", "show where adaptive rows sampled")
    ] = False,
    line: Annotated[
        int | None,
        option(PICTURE, "show line Y through time below each image", "--slice", value="Y", min=0),
    ] = None,
    crop: Annotated[
        Crop | None,
        option(
            PICTURE,
            "part of the frame, in pixels; default: all",
            value="X,Y,W,H",
            parse=parse_crop,
        ),
    ] = None,
    columns: Annotated[int | None, option(PICTURE, "images in a line; default: all", min=1)] = None,
    labels: Annotated[
        bool,
        flag(PICTURE, "--labels/--no-labels", "row, spp and PSNR of the frame above each image"),
    ] = True,
    titles: Annotated[
        list[str] | None,
        option(PICTURE, "titles instead of the names of rows, in their order", value="A,B"),
    ] = None,
    fps: Annotated[
        float,
        number(PLAYBACK, "frames of the clip in a second", "FPS"),
    ] = 8.0,
    ping_pong: Annotated[bool, flag(PLAYBACK, "--ping-pong", "forwards, then backwards")] = False,
    repeat: Annotated[
        int | None,
        option(
            PLAYBACK,
            "times an MP4 plays; default: until 4 s have passed; a WebP plays for ever",
            min=1,
        ),
    ] = None,
    quality: Annotated[int, option(OUTPUT, "of WebP", min=0, max=100)] = 90,
) -> None:
    """Write videos of stored images, one for each clip and budget.

    Images are those of `rlbench run --keep-images`, in clipped sRGB.

    Examples:

    \b
      rlbench video results -m mean,oidn,ours --reference --zoom 3
      rlbench video results -m ours,ntas --layout wipe --scenes city --format mp4,webp
      rlbench video results -m ours,ours/A2 --samples --slice 96 --ping-pong
    """
    from rlbench.apps.view.video import VideoStyle, check_formats, write
    from rlbench.benchmark.cell_images import find_all_images
    from rlbench.benchmark.shown_clips import at_budget, find_shown_clips
    from rlbench.cli import console
    from rlbench.system.paths import check_writable

    target = out or results / "video"
    check_writable(target)
    suffixes = split_names(formats) or ["webp"]
    check_formats(suffixes)
    style = fill(VideoStyle, locals(), titles=tuple(split_names(titles)))
    rows = read_rows(results, scenes=scenes)
    names = _order_methods(rows, split_names(methods), results)
    from reports.analysis.rows import nearest_budget

    budgets = spp or (nearest_budget(set(rows["target_spp"])),)
    own_clips = set(rows.loc[rows["method"].isin(names), "clip"])
    kept = find_all_images(results, names, own_clips, budgets)
    for images in {each.cell.key.clip: each for each in kept}.values():
        _, height, width = images.frame(0).image.shape
        style.check(len(names), reference, height, width)
    shown_clips = find_shown_clips(results, find_sources(kept, clips), names, budgets, buffers=())
    lengths = [max(map(len, images)) for _, images in shown_clips.kept]
    per_clip = [style.pictures_written(length, suffixes) for length in lengths]
    files = []
    with console.counting("pictures", len(budgets) * sum(per_clip)) as on_picture:
        for clip in shown_clips:
            clip = clip if reference else replace(clip, reference=clip.reference[:0])
            for budget in budgets:
                chosen = at_budget(clip, names, budget, rows)
                files += write(chosen, target, suffixes, style, on_picture)
    for file in files:
        typer.echo(file)


def _order_methods(rows: pd.DataFrame, names: list[str], results: Path) -> list[str]:
    """The rows that `names` select, in their order; without names all, those with least PSNR first.

    Raises OptionError for a name without rows.
    """
    if names:
        selected = (sorted(set(select_methods(rows, [n], results)["method"])) for n in names)
        return list(dict.fromkeys(method for group in selected for method in group))
    scores = rows[rows["metric"] == "psnr"].groupby("method")["value"].mean()
    return [str(method) for method in scores.sort_values().index]
