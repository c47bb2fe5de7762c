"""Plugins by name: methods, metrics, reports, pools and scenes, imported when they are used."""

from rlbench.errors import PluginError
from rlbench.registry.discovery import (
    GROUPS,
    VARIABLE,
    entries,
    module_file,
    resolve,
)
from rlbench.registry.entry import PluginEntry
from rlbench.registry.lookup import (
    current_name,
    family,
    import_error,
    load,
    load_or_explain,
    metrics,
    names,
    variant,
)
from rlbench.registry.methods import (
    expand,
    is_trainable,
    method,
    shipped_weights,
    training_task,
)
from rlbench.registry.plugin_files import clear_plugins, plugin_file, use_plugin

__all__ = [
    "GROUPS",
    "VARIABLE",
    "PluginEntry",
    "PluginError",
    "clear_plugins",
    "current_name",
    "entries",
    "expand",
    "family",
    "import_error",
    "is_trainable",
    "load",
    "load_or_explain",
    "method",
    "metrics",
    "module_file",
    "names",
    "plugin_file",
    "resolve",
    "shipped_weights",
    "training_task",
    "use_plugin",
    "variant",
]
