"""The command view: one page to look at the results."""

from __future__ import annotations

import webbrowser
from pathlib import Path
from typing import Annotated, Any

import typer

from rlbench.cli import options
from rlbench.cli.methods import load_plugins
from rlbench.cli.options import OUTPUT, file, flag, number
from rlbench.cli.selection import find_images, read_rows


def view(
    results: options.RunFolder = Path("results"),
    open_page: Annotated[bool, flag(OUTPUT, "--open", "open the page in a browser")] = False,
    methods: options.RowMethods = None,
    scenes: options.Scenes = None,
    clips: options.Clips = None,
    spp: options.ShownBudgets = None,
    out: Annotated[Path | None, file("page to write; default: RESULTS/report.html")] = None,
    max_mb: Annotated[
        float,
        number(OUTPUT, "largest size of the page; images are rounded until they fit", "MB"),
    ] = 20.0,
    plugin: options.Plugins = None,
    gbuffer_ms: options.GbufferMs = None,
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
    import reports.viewer
    from reports.analysis.rows import charge_gbuffer
    from rlbench.system.paths import check_writable

    target = out or results / "report.html"
    check_writable(target.parent)
    rows = charge_gbuffer(read_rows(results, methods, scenes), gbuffer_ms)
    found, reason = find_images(results, rows, clips, spp)
    remarks = [f"the page has decision and table alone: {reason}"] if reason else []
    traits = {name: describe_traits(name) for name in sorted(set(rows["method"]))}
    images = list(found)
    remarks += reports.viewer.write(rows, target, images, traits, remarks, int(max_mb * 1e6))
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
        family, variant = registry.find_method(method)
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
