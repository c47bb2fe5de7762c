"""The command view: one page to look at the results, or at image files."""

from __future__ import annotations

import webbrowser
from collections.abc import Collection
from pathlib import Path
from typing import Annotated, Any

import typer

from rlbench.cli import options
from rlbench.cli.methods import load_plugins
from rlbench.cli.options import CLIPS, OUTPUT, file, flag, number, option
from rlbench.cli.selection import find_images, read_rows
from rlbench.errors import OptionError

OF_RESULTS = ("methods", "scenes", "clips", "spp", "plugin", "gbuffer_ms")


def view(
    context: typer.Context,
    results: Annotated[
        Path,
        typer.Argument(
            metavar="RESULTS|IMAGE", help="folder of rlbench run; or an EXR, PFM or PNG file"
        ),
    ] = Path("results"),
    images: Annotated[
        list[Path] | None, typer.Argument(metavar="IMAGE...", help="more files, of the same size")
    ] = None,
    open_page: Annotated[bool, flag(OUTPUT, "--open", "open the page in a browser")] = False,
    methods: options.RowMethods = None,
    scenes: options.Scenes = None,
    clips: options.Clips = None,
    spp: options.ShownBudgets = None,
    out: Annotated[
        Path | None,
        file("page to write; default: RESULTS/report.html, of image files gallery.html"),
    ] = None,
    max_mb: Annotated[
        float,
        number(OUTPUT, "largest size of the page; images are rounded until they fit", "MB"),
    ] = 20.0,
    plugin: options.Plugins = None,
    gbuffer_ms: options.GbufferMs = None,
    layer: Annotated[
        str, option(CLIPS, "layer of EXR images that have several, as Blender's", value="NAME")
    ] = "",
) -> None:
    """Write one page to look at results or image files.

    The page needs no network: decide, compare images in place, their layers, their course in time,
    and a table. Images are those of `rlbench run --keep-images`; without them it has decision and
    table. Of image files it shows the images and their differences.

    Examples:

    \b
      rlbench view results --open
      rlbench view results -m ours,ntas,oidn --scenes city,hall --out city.html
      rlbench view mine --clips my_renders/ --spp 0.5,1 --max-mb 60
      rlbench view noisy.exr denoised.exr reference.png --open
    """
    from rlbench.system.paths import check_writable

    files = _image_files(context, results, images or [])
    target = out or (Path("gallery.html") if files else results / "report.html")
    check_writable(target.parent)
    if files:
        remarks = _write_gallery(files, layer, target, int(max_mb * 1e6))
    else:
        if layer:
            raise OptionError(f"--layer {layer} is for image files. Omit it")
        load_plugins(plugin)
        import rlbench.apps.view.viewer
        from reports.analysis.rows import charge_gbuffer
        from rlbench.benchmark.run_outcome import uncertainty_remark

        rows = charge_gbuffer(read_rows(results, methods, scenes), gbuffer_ms)
        opening = rlbench.apps.view.viewer.choose_opening(rows)
        near = opening.spp if opening else 1.0
        clips_to_show, reason = find_images(results, rows, clips, spp, near)
        remarks = [f"the page has decision and table alone: {reason}"] if reason else []
        traits = {name: describe_traits(name) for name in sorted(set(rows["method"]))}
        remarks += rlbench.apps.view.viewer.write(
            rows, target, list(clips_to_show), traits, remarks, int(max_mb * 1e6), opening
        )
        remarks += uncertainty_remark(rows, results)
    typer.echo(target)
    for remark in remarks:
        typer.echo(remark, err=True)
    if open_page:
        webbrowser.open(target.resolve().as_uri())


def _image_files(context: typer.Context, results: Path, others: list[Path]) -> list[Path]:
    """The image files among the arguments; none for a results folder.

    Raises OptionError for folders among several arguments, and for options of results with images.
    """
    from rlbench.clips.linear_images import ENCODINGS

    paths = [results, *others]
    folders = [path for path in paths if path.is_dir()]
    if len(paths) == 1 and (folders or not _is_image(results, ENCODINGS)):
        return []
    if folders:
        raise OptionError(
            f"{folders[0]} is a folder, and {len(paths)} paths are given. A page shows one folder "
            f"of results, or image files, such as {folders[0]}/*.exr"
        )
    if given := [name for name in OF_RESULTS if context.params[name]]:
        raise OptionError(f"--{given[0].replace('_', '-')} is for results, not for image files")
    return paths


def _is_image(path: Path, suffixes: Collection[str]) -> bool:
    return path.is_file() or path.suffix.lower() in suffixes


def _write_gallery(files: list[Path], layer: str, target: Path, max_bytes: int) -> list[str]:
    """Write a page of image files; returns remarks on them."""
    import rlbench.apps.view.viewer
    from rlbench.apps.view.gallery import read_gallery
    from rlbench.cli import console

    with console.counting("reading images", len(files)) as advance:
        gallery, remarks = read_gallery(files, layer, advance)
    rlbench.apps.view.viewer.write_gallery(gallery, target, remarks, max_bytes)
    return remarks


def describe_traits(row_name: str) -> dict[str, Any]:
    """What a method of the results needs, for filters; empty for one that is not installed."""
    from rlbench import registry
    from rlbench.benchmark.results import RowName

    method = RowName.parse(row_name).method_name
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
