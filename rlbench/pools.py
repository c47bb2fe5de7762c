"""Kinds of sample pool: how the samples were drawn that a method buys."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class PoolKind:
    """A way of drawing samples. `name` is what traits and clip.toml say."""

    name: str
    title: str


PATH = PoolKind("path", "independent path-traced samples, one per pixel and image")
