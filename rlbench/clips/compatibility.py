"""Which budgets and which methods a clip can be measured with, and why others cannot."""

from __future__ import annotations

from rlbench import registry
from rlbench.clips.header import OPTIONAL_BUFFERS, Header
from rlbench.family import Traits


def compatibility_summary(header: Header) -> str:
    """The budgets and the methods that can be measured on a clip, and why other methods cannot."""
    runnable: list[str] = []
    by_reason: dict[str, list[str]] = {}
    for name in registry.list_plugins("methods"):
        reason = registry.import_error("methods", name)
        reason = reason or incompatibility(header, registry.get_variant(name).traits, 1.0)
        (by_reason.setdefault(reason, []) if reason else runnable).append(name)
    budget = header.pool_spp
    text = f"budgets up to {budget} spp can be measured with: {', '.join(runnable) or 'no method'}"
    others = [f"{', '.join(names)} ({reason})" for reason, names in by_reason.items()]
    if others:
        text += f"; not with {'; '.join(others)}"
    if budget == 1:
        text += ". With one sample per pixel, an adaptive method can only leave pixels out"
    return text


def incompatibility(
    header: Header, traits: Traits, spp: float, pool_spp: int | None = None
) -> str | None:
    """Why a method with these traits cannot run on a clip at `spp`, or None if it can.

    `pool_spp` is the number of samples per pixel in the pool, None: as many as the clip stores.
    """
    if spp > (pool_spp or header.pool_spp):
        return (
            f"{spp:g} spp requested, the clip stores {header.pool_spp} samples per pixel; "
            f"request at most {header.pool_spp} spp"
        )
    if reason := traits.unsupported_reason(spp):
        return reason
    if traits.pool not in header.pools:
        pools, hint = ", ".join(header.pools), _pool_hint(traits.pool, header)
        return f"needs a '{traits.pool}' pool, the clip has: {pools}{hint}"
    missing = traits.inputs - set(header.buffers) - ({"motion"} if header.static else set())
    if missing:
        buffers = ", ".join(header.buffers)
        hint = "; render the clip with them" if missing <= OPTIONAL_BUFFERS.keys() else ""
        return f"needs buffers {', '.join(sorted(missing))}, the clip has: {buffers}{hint}"
    return None


def _pool_hint(pool: str, header: Header) -> str:
    """How to add a pool that a plugin traces to a clip of a preset, for the end of a message."""
    if (
        not header.preset
        or pool not in registry.list_plugins("pools")
        or not registry.load_plugin("pools", pool).factory
    ):
        return ""
    return (
        "; `rlbench render` adds it to clips of presets that have it, if Mitsuba can trace with "
        "LLVM or CUDA on this machine (see `rlbench doctor`)"
    )
