"""Runs a user's Python scene file, and checks what its functions return."""

from __future__ import annotations

import hashlib
import importlib.util
import sys
import traceback
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from rlbench.render.scene import SceneError, Vertices

__all__ = ["checked_animation", "hash_modules", "run_file", "user_errors"]


def run_file(file: Path) -> ModuleType:
    """The module of a Python file, which may import modules from its folder."""
    name = f"rlbench_scene_{hashlib.sha256(file.read_bytes()).hexdigest()[:12]}"
    spec = importlib.util.spec_from_file_location(name, file)
    if spec is None or spec.loader is None:
        raise SceneError(f"{file} is not a Python file")
    module = importlib.util.module_from_spec(spec)
    sys.path.insert(0, str(file.resolve().parent))
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    finally:
        sys.path.remove(str(file.resolve().parent))
        del sys.modules[name]
    return module


def hash_modules(file: Path) -> str:
    """Hash of a Python file and of the imported modules in its folder."""
    loaded = [getattr(module, "__file__", None) for module in list(sys.modules.values())]
    modules = {Path(f).resolve() for f in loaded if f} | {file.resolve()}
    siblings = sorted(f for f in modules if f.parent == file.resolve().parent and f.is_file())
    digest = hashlib.blake2b(digest_size=16)
    for sibling in siblings:
        digest.update(hashlib.blake2b(sibling.read_bytes()).digest())
    return digest.hexdigest()


def checked_animation(
    moving: Callable[..., Any], rest: Vertices, file: Path
) -> Callable[[float], Vertices]:
    """The user's `moving` as a vertex animation whose results are checked.

    `rest` holds the vertices of all meshes that can move. Raises SceneError if `moving` fails,
    returns anything but vertices of these meshes, or moves other meshes than at time 0.
    """

    def move(time: float) -> Vertices:
        time = max(time, 0.0)
        with user_errors(file):
            moved = moving(time, {name: vertices.copy() for name, vertices in rest.items()})
        return _check_vertices(moved, rest, f"moving({time:g}, rest) of {file}")

    first = move(0.0)

    def animation(time: float) -> Vertices:
        moved = move(time)
        if moved.keys() != first.keys():
            raise SceneError(
                f"moving({time:g}, rest) of {file} moves {', '.join(moved) or 'nothing'}, but at "
                f"time 0 it moves {', '.join(first) or 'nothing'}. Return the same shapes always"
            )
        return moved

    return animation


@contextmanager
def user_errors(file: Path) -> Iterator[None]:
    """Raises an error in a user's file as SceneError with the line of that file."""
    try:
        yield
    except SceneError:
        raise
    except Exception as error:
        frames = traceback.extract_tb(error.__traceback__)
        path = file.resolve()
        line = next((f.lineno for f in reversed(frames) if Path(f.filename) == path), None)
        location = f"{file}, line {line}" if line else str(file)
        raise SceneError(f"{location}: {type(error).__name__}: {error}") from error


def _check_vertices(moved: Any, rest: Vertices, source: str) -> Vertices:
    """The vertices that a user's function returned, as float32."""
    if not isinstance(moved, Mapping):
        raise SceneError(f"{source} returned {type(moved).__name__}, expected a dict of vertices")
    if unknown := sorted(set(moved) - set(rest)):
        raise SceneError(
            f"{source} moves '{unknown[0]}', which is not a mesh with an id; meshes that can move: "
            f"{', '.join(rest) or 'none'}"
        )
    converted = {name: np.asarray(vertices, np.float32) for name, vertices in moved.items()}
    for name, vertices in converted.items():
        if vertices.shape != rest[name].shape or not np.isfinite(vertices).all():
            raise SceneError(
                f"{source}: '{name}' has vertices of shape {list(vertices.shape)}, expected finite "
                f"ones of shape {list(rest[name].shape)}"
            )
    return converted
