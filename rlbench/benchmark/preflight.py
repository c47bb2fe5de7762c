"""Checks of what was requested, before anything is rendered, traced, measured or trained."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

from rlbench import registry
from rlbench.benchmark import cost_profile
from rlbench.errors import OptionError
from rlbench.render.presets import get_preset
from rlbench.system import paths
from rlbench.system.paths import check_writable
from rlbench.weights import read_card

__all__ = ["check_budgets", "check_run", "check_times_alone"]


def check_run(
    methods: Collection[str],
    target_spp: Collection[float],
    out: Path,
    preset: str | None,
    cost: str = cost_profile.MEASURED,
    weights: str | None = None,
    pool: str = "stored",
) -> None:
    """Check the options of a run that need no clip; nothing is written and no clip is opened.

    `preset` is that of the clips, None for clips in folders; their samples are those of `pool`
    (rlbench.benchmark.clip_sources.POOLS). Raises CostError for a cost profile,
    WeightsError for a weights file or its card, PluginError for a metric that cannot be used,
    WriteError where the results or the cache cannot be written, UnknownPresetError, and
    OptionError where no method can be measured at any budget.
    """
    if cost != cost_profile.MEASURED:
        cost_profile.profile(cost)
    if weights not in (None, "random"):
        read_card(Path(weights))
    if preset is not None:
        check_budgets(methods, target_spp, preset, pool)
    registry.load_run_metrics()
    check_writable(out)
    check_writable(paths.cache_folder(), "RLBENCH_CACHE")


def check_budgets(
    methods: Collection[str], target_spp: Collection[float], preset: str, pool: str = "stored"
) -> None:
    """Raise OptionError where no method can be measured on the preset's clips at any budget.

    A method that cannot at some budgets is skipped there, with the reason in its row. Live samples
    are traced when they are drawn, so there are as many as a budget needs.
    """
    stored = get_preset(preset).pool_spp
    if pool == "stored" and min(target_spp, default=0.0) > stored:
        raise OptionError(
            f"--spp {_join(target_spp)}: the clips of preset '{preset}' store {stored} samples per "
            f"pixel, and no method is measured with more; request at most {stored}, or trace "
            "more with --pool live"
        )
    traits = {name: registry.get_variant(name).traits for name in methods}
    reasons = {
        f"{name} {reason}": None
        for spp in target_spp
        for name, each in traits.items()
        if (reason := each.unsupported_reason(spp))
    }
    if reasons and len(reasons) == len(traits) * len(target_spp):
        raise OptionError(f"--spp {_join(target_spp)}: {'; '.join(reasons)}")


def check_times_alone(scores_only: bool, keep_images: bool) -> None:
    """Raise OptionError for options that contradict `--retime`."""
    if scores_only:
        raise OptionError("--retime measures times alone, --scores-only scores alone. Omit one")
    if keep_images:
        raise OptionError(
            "--retime measures times alone, so it makes no images. Use --keep-images without it"
        )


def _join(budgets: Collection[float]) -> str:
    return ",".join(f"{spp:g}" for spp in budgets)
