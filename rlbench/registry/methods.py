"""Methods by name: built for inference, built for training, and selected by patterns."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rlbench.errors import PluginError
from rlbench.registry.discovery import module_file, resolve
from rlbench.registry.lookup import (
    current_name,
    get_variant,
    import_error,
    list_plugins,
    load_family,
)
from rlbench.registry.plugin_code import exits_as_errors
from rlbench.system import provenance

if TYPE_CHECKING:
    import torch

    from rlbench.method import Method

__all__ = ["expand", "is_trainable", "load_method", "shipped_weights", "training_task"]


def load_method(
    name: str, device: torch.device | str = "cpu", weights: str | None = None
) -> Method:
    """Build the method `family` or `family/variant` on a device.

    `weights` is None for the pretrained weights, the path of a file, or "random".

    >>> load_method("mean").traits.pool
    'path'

    Raises PluginError if a package that the method requires is not installed, or if its traits are
    not those that its family declares.
    """
    import torch

    from rlbench.method import Method

    name = current_name(name)
    declared = get_variant(name)
    if missing := " ".join(provenance.missing_packages(declared.requires)):
        raise PluginError(
            f"'{name}' needs {missing}, which is not installed: pip install {missing}"
        )
    build = load_family(name).build
    with exits_as_errors():
        instance = resolve(build)(name.partition("/")[2], torch.device(device), weights)
    if not isinstance(instance, Method):
        raise PluginError(
            f"{build} returned an object of type {type(instance).__name__}, not a Method"
        )
    if instance.traits != declared.traits:
        raise PluginError(
            f"'{name}' is declared with {declared.traits}, but {build} returned {instance.traits}"
        )
    return instance


def shipped_weights(name: str) -> Path:
    """The file of a method's pretrained weights, whether or not it exists.

    It lies in the folder `cards` beside the module that builds the method, or the method whose
    weights it uses.

    >>> shipped_weights("oidn/small").name
    'small.safetensors'

    Raises PluginError if there is no such module.
    """
    name = get_variant(name).weights_from or current_name(name)
    parent = load_family(name)
    return module_file(parent.build).parent / "cards" / parent.weights_file(name.partition("/")[2])


def training_task(name: str, device: torch.device | str = "cpu", seed: int = 0) -> Any:
    """The `rlbench.training.task.TrainingTask` of a method.

    Raises PluginError for a method without trainable weights.
    """
    import torch

    name = current_name(name)
    if not is_trainable(name):
        raise PluginError(f"'{name}' has nothing to train")
    with exits_as_errors():
        return resolve(load_family(name).train)(name.partition("/")[2], torch.device(device), seed)


def is_trainable(name: str) -> bool:
    """Whether a method has weights of its own and a function that trains them."""
    declared = get_variant(name)
    return declared.learned and declared.weights_from is None and bool(load_family(name).train)


def expand(
    patterns: Iterable[str],
    pretrained_only: bool = True,
    on_skip: Callable[[str], None] | None = None,
) -> list[str]:
    """Method names for patterns, without repeats.

    `all` stands for every family, `family/*` for all variants of one, `all/*` for all variants of
    every family. By default a pattern with `*` leaves out variants without pretrained weights.
    With `on_skip`, `all` skips families that cannot be imported and passes a message for each.

    >>> expand(["mean", "svgf", "mean"])
    ['mean', 'svgf']

    Raises PluginError for an unknown name.
    """
    selected: dict[str, None] = {}
    for pattern in patterns:
        key, _, rest = pattern.partition("/")
        for parent in _families(on_skip) if key == "all" else [key]:
            exact = f"{parent}/{rest}" if rest else parent
            for name in (
                load_family(parent).method_names() if rest == "*" else [current_name(exact)]
            ):
                if get_variant(name).pretrained or not pretrained_only or rest != "*":
                    selected[name] = None
    return list(selected)


def _families(on_skip: Callable[[str], None] | None) -> list[str]:
    """All families; with `on_skip`, only those that can be imported."""
    importable = []
    for name in list_plugins("methods"):
        if on_skip and (error := import_error("methods", name)):
            on_skip(f"'all' skips {name}, which cannot be imported: {error}")
        else:
            importable.append(name)
    return importable
