"""What can be measured on a clip: budgets, and which methods have all that they read."""

from __future__ import annotations

from rlbench.benchmark.clip_sources import unusable
from rlbench.clips.header import Header
from rlbench.registry import lookup as registry


def possible(header: Header) -> str:
    """In words: the budgets, the methods that can run on the clip, and why others cannot."""
    able, unable = [], []
    for name in registry.names("methods"):
        why = registry.broken("methods", name)
        why = why or unusable(header, registry.variant(name).traits, 1.0)
        unable.append(f"{name} ({why})") if why else able.append(name)
    most = header.pool_spp
    told = f"budgets up to {most} spp can be measured with: {', '.join(able) or 'no method'}"
    if unable:
        told += f"; not with {'; '.join(unable)}"
    if most == 1:
        told += ". With one sample of each pixel, to adapt is only to leave pixels out"
    return told
