"""What can be measured on a clip: budgets, and which methods have all that they read."""

from __future__ import annotations

from rlbench import registry
from rlbench.clips.header import Header
from rlbench.family import Traits


def compatibility_summary(header: Header) -> str:
    """In words: the budgets, the methods that can run on the clip, and why others cannot."""
    able, unable = [], []
    for name in registry.names("methods"):
        why = registry.import_error("methods", name)
        why = why or incompatibility(header, registry.variant(name).traits, 1.0)
        unable.append(f"{name} ({why})") if why else able.append(name)
    most = header.pool_spp
    told = f"budgets up to {most} spp can be measured with: {', '.join(able) or 'no method'}"
    if unable:
        told += f"; not with {'; '.join(unable)}"
    if most == 1:
        told += ". With one sample of each pixel, to adapt is only to leave pixels out"
    return told


def _hint(pool: str) -> str:
    """How a clip comes by a pool that a plugin traces."""
    if pool not in registry.names("pools") or not registry.load("pools", pool).make:
        return ""
    return (
        "; `rlbench render` adds it to clips of presets that have it, where Mitsuba traces with "
        "LLVM or CUDA (see `rlbench doctor`)"
    )


def incompatibility(header: Header, traits: Traits, spp: float) -> str | None:
    """Why a method with these traits cannot run on a clip at `spp`, or None if it can."""
    if refused := traits.unsupported_reason(spp):
        return refused
    if traits.pool not in header.pools:
        have = ", ".join(header.pools)
        return f"buys from a '{traits.pool}' pool, the clip has: {have}{_hint(traits.pool)}"
    absent = traits.inputs - set(header.buffers) - ({"motion"} if header.static else set())
    if absent:
        have = ", ".join(header.buffers) or "none"
        return f"reads {', '.join(sorted(absent))}, the clip has: {have}"
    if spp > header.pool_spp:
        return f"{spp:g} spp asked for, the clip holds {header.pool_spp} samples of each pixel"
    return None
