"""Methods by name: built for inference, built for training, and selected by patterns."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import contextmanager
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rlbench.errors import PluginError
from rlbench.registry.discovery import list_entries, module_file, plugin_file_error, resolve
from rlbench.registry.lookup import (
    find_method,
    get_variant,
    import_error,
    list_plugins,
    load_family,
)
from rlbench.registry.plugin_code import exits_as_errors
from rlbench.registry.plugin_files import file_entries, plugin_file, plugin_files
from rlbench.registry.stand_ins import import_failure, stand_ins
from rlbench.system import code_hash, provenance

if TYPE_CHECKING:
    import torch

    from rlbench.method import Method

MEMBERS = ("traits", "start", "plan", "denoise")  # of a Method


def load_method(
    name: str, device: torch.device | str = "cpu", weights: str | None = None
) -> Method:
    """Build the method `family` or `family/variant` on a device.

    `weights` is None for the pretrained weights, the path of a file, or "random".

    >>> load_method("mean").traits.pool
    'path'

    Raises PluginError if a package that the method requires is not installed, if no weights are
    shipped for it and none are named, or if its traits are not those that its family declares.
    """
    import torch

    from rlbench.method import Method

    if failure := import_failure(name):
        raise failure
    family, declared = find_method(name)
    if missing := " ".join(provenance.missing_packages(declared.requires)):
        raise PluginError(
            f"'{name}' needs {missing}, which is not installed: pip install {missing}"
        )
    if weights is None and not declared.pretrained and not shipped_weights(name).is_file():
        raise PluginError(
            f"no weights are shipped for '{name}'. Train some with 'rlbench train -m {name}', and "
            "name the file with --weights"
        )
    build = family.build
    with exits_as_errors():
        instance = resolve(build)(name.partition("/")[2], torch.device(device), weights)
    if not isinstance(instance, Method):
        lacks = [name for name in MEMBERS if not hasattr(instance, name)]
        raise PluginError(
            f"{build} returned an object of type {type(instance).__name__}, not a Method: it has "
            f"no {', no '.join(lacks)}"
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

    >>> shipped_weights("oidn/tuned").name
    'tuned.safetensors'

    Raises PluginError if there is no such module.
    """
    owner = get_variant(name).weights_from or name
    family = load_family(owner)
    return module_file(family.build).parent / "cards" / family.weights_file(owner.partition("/")[2])


def training_task(name: str, device: torch.device | str = "cpu", seed: int = 0) -> Any:
    """The `rlbench.training.task.TrainingTask` of a method.

    Raises PluginError for a method that cannot be trained.
    """
    import torch

    if reason := untrainable_reason(name):
        raise PluginError(f"'{name}' {reason}")
    with exits_as_errors():
        return resolve(load_family(name).train)(name.partition("/")[2], torch.device(device), seed)


def method_code_hash(method: str) -> str:
    """Hash of what builds a method, of what this imports, and of the core; 16 hex digits.

    Imports from packages of other methods count too. Empty where the code cannot be found; building
    the method then reports the reason.
    """
    module = load_family(method).build.partition(":")[0]
    try:
        file = plugin_file(module)
        if file is None:
            return code_hash.code_hash(code_hash.import_closure(module, _method_packages()))
        imports = code_hash.code_hash(code_hash.closure_of_file(file, _method_packages()))
    except LookupError:
        return ""
    return sha256(imports.encode() + file.read_bytes()).hexdigest()[:16]


def metrics_code_hash(names: Iterable[str], core: Collection[str]) -> str:
    """Hash of what defines these metrics, of what this imports, and of the modules `core`."""
    known = list_entries("metrics")
    defining = sorted({known[name].target.partition(":")[0] for name in names})
    files = [file for module in defining if (file := plugin_file(module))]
    modules = set[str]().union(
        *(code_hash.import_closure(each) for each in defining if not plugin_file(each)),
        *(code_hash.closure_of_file(file, ["metrics"]) for file in files),
    )
    own = "".join(sha256(file.read_bytes()).hexdigest()[:16] for file in files)
    return code_hash.code_hash(modules, core=core) + own


def _method_packages() -> set[str]:
    """Top-level packages of installed methods: one method may use parts of another."""
    return {entry.target.partition(".")[0] for entry in list_entries("methods").values()}


def is_trainable(name: str) -> bool:
    """Whether a method has weights of its own, not published ones, and a function to train them."""
    family, declared = find_method(name)
    has_own_weights = declared.learned and declared.weights_from is None
    return has_own_weights and not declared.trained_by and bool(family.train)


def untrainable_reason(name: str) -> str | None:
    """Why a method cannot be trained, or None if it can.

    >>> untrainable_reason("mean")
    'has nothing to train'
    """
    if is_trainable(name):
        return None
    family, declared = find_method(name)
    if declared.learned and declared.weights_from:
        return f"has the weights of {declared.weights_from}: train that one"
    if not (author := declared.trained_by):
        return "has nothing to train"
    reason = f"has weights that {author} trained and published, so rlbench does not train it"
    trainable = ", ".join(filter(is_trainable, family.method_names()))
    return f"{reason}. Rows of its family to train: {trainable}" if trainable else reason


def expand(
    patterns: Iterable[str],
    pretrained_only: bool = True,
    on_skip: Callable[[str], None] | None = None,
) -> list[str]:
    """Method names for patterns, without repeats.

    `all` stands for every family, `family/*` for all variants of one, `all/*` for all variants of
    every family. By default `all` and `*` leave out rows without pretrained weights.
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
            family = load_family(parent)
            for name in family.method_names() if rest == "*" else [exact]:
                is_named = key != "all" and rest != "*"
                if is_named or get_variant(name).pretrained or not pretrained_only:
                    selected[name] = None
    return list(selected)


@contextmanager
def with_broken(
    patterns: Iterable[str], on_broken: Callable[[str], None] = lambda text: None
) -> Iterator[None]:
    """Within it, methods that cannot be imported can be run: each cell of them fails with a reason.

    That holds for those in `patterns`, and with `all` for those of plugin files. `on_broken` is
    called with the reason of each.

    Raises PluginError where no pattern names a method that can be imported, and for a plugin file
    that cannot be imported and is not in the patterns.
    """
    names = list(patterns)
    keys = dict.fromkeys(name.partition("/")[0] for name in names)
    reasons = _broken_files()
    if "all" not in keys and (unnamed := [key for key in reasons if key not in keys]):
        raise PluginError(reasons[unnamed[0]])
    for key in keys:
        known = list_entries("methods").get(key)
        if known and key not in reasons and (error := import_error("methods", key)):
            reasons[key] = f"{key} from {known.origin} cannot be imported: {error}"
    if reasons and keys.keys() <= reasons.keys():
        raise PluginError("; ".join(reasons.values()))
    for reason in reasons.values():
        on_broken(reason)
    with stand_ins(reasons, names):
        yield


def _broken_files() -> dict[str, str]:
    """Why the plugin files that cannot be imported fail, by the name of their entry."""
    errors = {file: error for file in plugin_files() if (error := plugin_file_error(file))}
    return {
        entry.name: f"{entry.name} from {entry.origin} cannot be imported: {error}"
        for file, error in errors.items()
        for entry in file_entries(file)
    }


def _families(on_skip: Callable[[str], None] | None) -> list[str]:
    """All families; with `on_skip`, only those that can be imported."""
    importable = []
    for name in list_plugins("methods"):
        if on_skip and (error := import_error("methods", name)):
            on_skip(f"'all' skips {name}, which cannot be imported: {error}")
        else:
            importable.append(name)
    return importable
