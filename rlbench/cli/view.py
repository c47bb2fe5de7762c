"""The command view: one page to look at the results."""

from __future__ import annotations

import webbrowser
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from rlbench.cli import arguments, options
from rlbench.cli.plugins import load_plugins
from rlbench.errors import OptionError

if TYPE_CHECKING:
    import pandas as pd

    from rlbench.benchmark.cell_images import KeptImages
    from rlbench.benchmark.clip_sources import StoredSource
    from rlbench.benchmark.shown_clips import ShownClip, ShownClips

__all__ = [
    "describe_traits",
    "find_images",
    "find_sources",
    "nearest_to_one",
    "read_images",
    "view",
]

NAME = "viewer"  # of the page, among the entry points


def view(
    results: Annotated[
        Path, typer.Argument(metavar="RESULTS", help="folder of rlbench run", file_okay=False)
    ] = Path("results"),
    out: Annotated[
        Path | None,
        typer.Option(
            dir_okay=False,
            metavar="FILE",
            help="page to write; default: RESULTS/report.html",
            rich_help_panel=options.OUTPUT,
        ),
    ] = None,
    max_mb: Annotated[
        float,
        typer.Option(
            parser=arguments.parse_positive,
            metavar="MB",
            help="largest size of the page; images are rounded until they fit",
            rich_help_panel=options.OUTPUT,
        ),
    ] = 20.0,
    open_page: Annotated[
        bool,
        typer.Option("--open", help="open the page in a browser", rich_help_panel=options.OUTPUT),
    ] = False,
    methods: options.RowMethods = None,
    plugin: options.Plugins = None,
    scenes: options.Scenes = None,
    clips: options.Clips = None,
    spp: options.ShownBudgets = None,
) -> None:
    """Write one page to look at the results; it needs no network.

    Decide, compare images in place, their layers, their course in time, and a table. Images are
    those of `rlbench run --keep-images`; without them the page has decision and table.

    Examples:

    \b
      rlbench view results --open
      rlbench view results -m ours,ntas,oidn --scenes city,hall --out city.html
      rlbench view mine --clips my_renders/ --spp 0.5,1 --max-mb 60
    """
    load_plugins(plugin)
    from rlbench import registry
    from rlbench.benchmark.results import read
    from rlbench.cli.decide import select_scenes
    from rlbench.cli.reports import select_rows
    from rlbench.system.paths import check_writable

    target = out or results / "report.html"
    check_writable(target.parent)
    rows = read(results)
    if names := arguments.split_names(methods):
        rows = select_rows(rows, names, results)
    if names := arguments.split_names(scenes):
        rows = select_scenes(rows, names, results)
    images, remarks = read_images(results, rows, clips, spp)
    page = registry.load_or_explain("pages", NAME)
    traits = {name: describe_traits(name) for name in sorted(set(rows["method"]))}
    remarks += page.write(rows, target, images, traits, remarks, int(max_mb * 1e6))
    typer.echo(target)
    for remark in remarks:
        typer.echo(remark, err=True)
    if open_page:
        webbrowser.open(target.resolve().as_uri())


def describe_traits(row_name: str) -> dict[str, Any]:
    """What a method of the results needs, for filters; empty for one that is not installed."""
    from rlbench import registry
    from rlbench.benchmark.results import RowName

    method = RowName.parse(row_name).method
    try:
        family, variant = registry.load_family(method), registry.get_variant(method)
    except registry.PluginError:
        return {}
    traits = variant.traits
    return {
        "question": variant.question,
        "paper": family.paper,
        "learned": variant.learned,
        "adaptive": traits.adaptive,
        "temporal": traits.temporal,
        "pool": traits.pool,
        "inputs": sorted(traits.inputs),
    }


def read_images(
    results: Path,
    rows: pd.DataFrame,
    clips: list[Path] | None = None,
    spp: Collection[float] | None = None,
) -> tuple[list[ShownClip], list[str]]:
    """The clips of `rows` with their kept images, and a sentence if there are none to show."""
    found, reason = find_images(results, rows, clips, spp)
    return list(found), [f"the page has decision and table alone: {reason}"] if reason else []


def find_images(
    results: Path,
    rows: pd.DataFrame,
    clips: list[Path] | None = None,
    spp: Collection[float] | None = None,
) -> tuple[ShownClips, str]:
    """The clips of `rows` with their kept images, not read yet, or the reason why there are none.

    Raises OptionError for a budget in `spp` without images; the default is that nearest to 1 spp.
    """
    from rlbench.benchmark.cell_images import list_images
    from rlbench.benchmark.shown_clips import ShownClips, find_shown_clips

    methods, names = set(rows["method"]), set(rows["clip"])
    kept = [each for each in list_images(results) if each.cell.key.method in methods]
    kept = [each for each in kept if each.cell.key.clip in names]
    if not kept:
        hint = "repeat the command `rlbench run` with --keep-images"
        return ShownClips(), f"the results keep no images; {hint}"
    known = {each.cell.key.target_spp for each in kept}
    if unknown := set(spp or ()) - known:
        raise OptionError(
            f"--spp: no images at {_join(unknown)} spp; the results keep {_join(known)}"
        )
    budgets = spp or (nearest_to_one(known),)
    try:
        sources = find_sources(kept, clips)
    except OptionError as error:
        return ShownClips(), str(error)
    return find_shown_clips(results, sources, methods, budgets), ""


def find_sources(
    kept: Collection[KeptImages], clips: list[Path] | None = None
) -> Sequence[StoredSource]:
    """The clips that images show: folders, or those of the presets, rendered where they lack.

    Raises OptionError where a clip has no preset, and no folder is given.
    """
    from rlbench.benchmark.api import select_clips

    if clips:
        return select_clips(clips)
    by_preset: dict[str, set[str]] = {}
    for each in kept:
        by_preset.setdefault(each.cell.key.preset, set()).add(each.cell.key.clip)
    if strangers := by_preset.pop("", None):
        raise OptionError(
            f"the preset of {', '.join(sorted(strangers))} is not known; name the folder with "
            "--clips"
        )
    pools = {each.pool for each in kept}
    return [
        source
        for preset, own in sorted(by_preset.items())
        for source in select_clips(None, sorted(own), preset, pool_kinds=pools)
    ]


def _join(budgets: Collection[float]) -> str:
    return ", ".join(f"{spp:g}" for spp in sorted(budgets))


def nearest_to_one(budgets: Collection[float]) -> float:
    """The budget nearest to 1 spp in ratio.

    >>> nearest_to_one({0.5, 4.0})
    0.5
    """
    return min(sorted(budgets), key=lambda spp: max(spp, 1 / max(spp, 1e-9)))
