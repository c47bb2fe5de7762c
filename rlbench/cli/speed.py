"""The command speed: times of methods by size, backend and precision, on generated frames."""

from __future__ import annotations

from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rlbench.cli import options
from rlbench.cli.arguments import (
    PixelSize,
    PixelSizes,
    parse_sizes,
    split_names,
)
from rlbench.cli.methods import expand_methods, load_rows
from rlbench.cli.options import MEASUREMENT, METHODS, file, flag, folder, number, option
from rlbench.errors import OptionError

if TYPE_CHECKING:
    from rlbench.family import Variant

SIZES = PixelSizes((PixelSize(192, 192), PixelSize(720, 720), PixelSize(1080, 1920)))


def speed(
    context: typer.Context,
    methods: options.Methods = None,
    plugin: options.Plugins = None,
    sizes: Annotated[
        PixelSizes,
        option(
            MEASUREMENT,
            "192 (square), 640x480 or 1080p, a list a,b; default: 192,720,1080p",
            value="SIZES",
            parse=parse_sizes,
            show_default=False,
        ),
    ] = SIZES,
    backend: Annotated[
        list[str] | None,
        option(
            METHODS,
            "what runs networks: a list of eager, openvino, compile, graph; default: eager",
            value="NAMES",
        ),
    ] = None,
    half: Annotated[
        bool, flag(METHODS, "--half", "measure networks in half precision too")
    ] = False,
    repeats: options.Repeats = 10,
    device: options.Device = "auto",
    out: Annotated[Path, folder("folder of the table")] = Path("results/speed"),
    as_cost: Annotated[
        Path | None,
        file("also write the times as a cost profile, for decide --cost; needs --sample-ms"),
    ] = None,
    sample_ms: Annotated[
        float | None,
        number(
            MEASUREMENT,
            "for --as-cost: your renderer's time for one sample of every pixel of the first size",
            "MS",
        ),
    ] = None,
) -> None:
    """Time methods by image size, backend and precision.

    No score is measured. Frames are generated, so nothing is rendered. Writes speed.csv and
    speed.md: times of the parts of inference, parameters, multiply-adds per pixel, their share of
    the machine's peak, bytes of state per pixel, and memory. A time that is uncertain, because the
    machine was busy, says by how much. A method that an error stopped is named with its reason, and
    the exit code is then 1.

    Examples:

    \b
      rlbench speed -m ours,oidn/tuned,oidn-intel
      rlbench speed -m ours,ntas --sizes 1080p --backend eager,openvino --half
      rlbench speed -m mine,oidn-intel --plugin mine.py --sizes 640x480
      rlbench speed -m ours,svgf --device cuda --sizes 1080p --as-cost gpu.toml --sample-ms 4.2
    """
    if (as_cost is None) != (sample_ms is None):
        raise OptionError("--as-cost and --sample-ms need each other: a profile has both times")
    load_rows(context, plugin, split_names(methods) or ["all"])
    names = expand_methods(methods, pretrained_only=False, default="all")
    from rlbench import registry
    from rlbench.backends import EAGER, select_backend
    from rlbench.benchmark.cost_profile import write_profile
    from rlbench.benchmark.latency import device_name
    from rlbench.benchmark.planning import check_precision, select_device
    from rlbench.benchmark.speed import (
        Configuration,
        failed_rows,
        measure_speed,
        profile_times,
        write_speed,
    )
    from rlbench.cli import console
    from rlbench.system.paths import check_writable

    target = select_device(device)
    backends = [select_backend(name, target) for name in split_names(backend) or [EAGER]]
    check_precision(names, half, device)
    check_writable(out)
    if as_cost:
        check_writable(as_cost.parent)
    configurations = [
        Configuration(name, each, is_half)
        for name in names
        for each, is_half in product(backends, (False, True) if half else (False,))
        if _changes_something(registry.get_variant(name), each, is_half)
    ]
    with console.counting("timing", len(configurations) * len(sizes)) as advance:
        table = measure_speed(configurations, sizes, target, repeats, advance)
    for each in write_speed(table, target, out):
        typer.echo(each)
    if as_cost and sample_ms:
        times = profile_times(table)
        write_profile(as_cost, device_name(target), sizes[0], sample_ms, times)
        typer.echo(as_cost)
    if failures := failed_rows(table):
        for name, reason in failures.items():
            typer.echo(f"{name} has no times: {reason}", err=True)
        raise typer.Exit(1)


def _changes_something(variant: Variant, backend: str, half: bool) -> bool:
    """True if a row runs in other code by this backend and precision, and for eager itself."""
    from rlbench.backends import applicable_backend

    return applicable_backend(backend, variant) == backend and (variant.learned or not half)
