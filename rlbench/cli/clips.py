"""The commands render and lint: make the clips of presets, and check conventions of clips."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from rlbench.cli import arguments, options
from rlbench.cli.json_output import ChecksOutput, print_json

__all__ = ["lint", "render"]


def render(
    scenes: options.Scenes = None,
    preset: options.Preset = "mini",
    takes: options.Takes = None,
    seeds: options.SceneSeeds = None,
    radiance_cap: Annotated[
        float | None,
        typer.Option(
            parser=arguments.parse_positive,
            metavar="RADIANCE",
            help="scale brighter samples down to this multiple of display white",
            rich_help_panel=options.RENDERING,
        ),
    ] = None,
    buffers: Annotated[
        list[str] | None,
        typer.Option(
            "--buffers",
            metavar="NAMES",
            help="more G-buffer buffers a,b: object, albedo_first, normal_psr, ...",
            rich_help_panel=options.RENDERING,
        ),
    ] = None,
    remeasure_sample_time: Annotated[
        bool,
        typer.Option(
            "--remeasure-sample-time",
            help="also measure the time of a sample and a G-buffer again, on an idle machine",
            rich_help_panel=options.RENDERING,
        ),
    ] = False,
    digests: Annotated[
        bool,
        typer.Option(
            "--digests",
            help="print the name of each clip and the hash of its pixels, not its folder",
            rich_help_panel=options.OUTPUT,
        ),
    ] = False,
    engine: options.Engine = "local",
    ray_address: options.RayAddress = None,
) -> None:
    """Render the missing clips of a preset.

    Clips lie in the cache. A killed rendering resumes.

    Examples:

    \b
      rlbench render
      rlbench render --preset train --seeds 0:40
      rlbench render --scenes city,hall-cut --preset standard
      rlbench render --radiance-cap 64
      rlbench render --buffers object,normal_psr
      rlbench render --preset standard --engine ray --ray-address auto
      rlbench render --preset standard --remeasure-sample-time
      rlbench render --preset unseen --digests
    """
    from rlbench.parallel.ray_executor import open_executor
    from rlbench.render.jobs.render_clips import render_preset_clips
    from rlbench.system.paths import cache_folder, check_writable

    check_writable(cache_folder(), "RLBENCH_CACHE")
    names, buffer_names = arguments.split_names(scenes), arguments.split_names(buffers)
    with open_executor(engine, ray_address) as executor:
        folders = render_preset_clips(
            names, preset, radiance_cap, seeds, buffer_names, executor, takes=takes
        )
    for folder in folders:
        times = _remeasure(folder) if remeasure_sample_time else ""
        typer.echo(f"{_digest(folder) if digests else folder}{times}")


def _digest(folder: Path) -> str:
    """The clip's name and the first 12 digits of its content hash, as on model cards."""
    from rlbench.clips.stored import open_clip

    clip = open_clip(folder)
    return f"{clip.name} {clip.digest[:12]}"


def _remeasure(folder: Path) -> str:
    """Measure the times of a clip's tracer again; returns them as text, with the former one."""
    from rlbench.clips.stored import read_header
    from rlbench.render.jobs.render_clips import remeasure_sample_ms

    before_ms = read_header(folder).sample_ms
    after = remeasure_sample_ms(folder)
    spread = f"p5 {after.sample_p5_ms:.1f}, p95 {after.sample_p95_ms:.1f}"
    return (
        f"  a sample per pixel takes {after.sample_ms:.1f} ms ({spread}), before {before_ms:.1f} "
        f"ms; a G-buffer {after.gbuffer_ms:.1f} ms"
    )


def lint(
    clips: Annotated[
        list[Path],
        typer.Argument(metavar="CLIPS", exists=True, help="a clip, or a folder of clips"),
    ],
    figure: Annotated[
        Path | None,
        typer.Option(
            dir_okay=False, metavar="FILE", help="PNG to draw; with several clips, one for each"
        ),
    ] = None,
    frames: Annotated[int, typer.Option(min=0, help="first frames to read; 0: all")] = 8,
    guess: Annotated[
        bool,
        typer.Option("--guess", help="CLIPS is a dump of EXR files: guess the layout to import it"),
    ] = False,
    layout: Annotated[
        Path,
        typer.Option(dir_okay=False, metavar="FILE", help="file that --guess writes"),
    ] = Path("engine.toml"),
    as_json: options.Json = False,
) -> None:
    """Check a clip's motion, depth, normals, samples, reference.

    The exit code is 1 if a check failed. With --guess, write the layout of a dump for rlbench
    import instead, with how sure each reading is.

    Examples:

    \b
      rlbench lint my_renders/atrium
      rlbench lint my_renders/ --figure lint.png --frames 0
      rlbench lint --guess dump/ && rlbench import dump/ --layout engine.toml --out clips/
    """
    if guess:
        _write_guess(clips, layout)
        return
    from rlbench.checks.lint.checks import lint_clips
    from rlbench.clips.stored import find_all_clips

    folders = find_all_clips(clips)
    output = ChecksOutput() if as_json else None
    has_passed = lint_clips(folders, figure, frames, output.add if output else None)
    if output:
        print_json(output)
    raise typer.Exit(0 if has_passed else 1)


def _write_guess(sources: list[Path], layout: Path) -> None:
    """Write the layout of one dump, and print it."""
    from rlbench.checks.lint.guess import (
        format_guess,
        format_unclaimed,
        guess_layout,
        recognize_layout,
    )
    from rlbench.clips.importers.layout import decode_layout, read_layout, ready_layouts
    from rlbench.errors import OptionError
    from rlbench.system.paths import atomic_write, check_writable

    if len(sources) != 1 or not sources[0].is_dir():
        raise OptionError("--guess takes one folder of EXR files")
    if layout.exists():
        raise OptionError(f"{layout} exists; name another file with --layout, or remove it")
    check_writable(layout.parent, "--layout")
    if name := recognize_layout(sources[0]):
        text = ready_layouts()[name].read_text()
        unclaimed = format_unclaimed(sources[0], read_layout(name))
        typer.echo(f"sure: the ready layout '{name}' reads it, and no check of motion, depth and")
        typer.echo("normals fails\n")
    else:
        guess = guess_layout(sources[0])
        text = format_guess(guess)
        typer.echo(text)
        unclaimed = format_unclaimed(sources[0], decode_layout(guess.tables, "guess"))
    typer.echo(unclaimed)
    with atomic_write(layout) as file:
        file.write_text(text + unclaimed)
    typer.echo(f"written to {layout}. Next:")
    typer.echo(f"  rlbench import {sources[0]} --layout {layout} --out clips/")
