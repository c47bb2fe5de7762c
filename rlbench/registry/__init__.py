"""Plugins by name: methods, metrics, reports, pools and scenes, imported when they are used."""

from rlbench.errors import PluginError
from rlbench.registry.discovery import (
    GROUPS,
    list_entries,
    module_file,
    resolve,
)
from rlbench.registry.lookup import (
    failure_reason,
    find_method,
    get_variant,
    import_error,
    list_plugins,
    load_family,
    load_memory_metrics,
    load_metrics,
    load_or_explain,
    load_plugin,
    load_run_metrics,
)
from rlbench.registry.methods import (
    expand,
    is_trainable,
    load_method,
    method_code_hash,
    metrics_code_hash,
    shipped_weights,
    training_task,
    untrainable_reason,
    with_broken,
)
from rlbench.registry.plugin_code import PluginExitError, exits_as_errors
from rlbench.registry.plugin_files import (
    PluginEntry,
    clear_plugins,
    plugin_file,
    plugin_file_methods,
    use_plugin,
)
from rlbench.registry.stand_ins import import_failure

__all__ = [
    "GROUPS",
    "PluginEntry",
    "PluginError",
    "PluginExitError",
    "clear_plugins",
    "list_entries",
    "exits_as_errors",
    "expand",
    "failure_reason",
    "find_method",
    "load_family",
    "import_error",
    "import_failure",
    "is_trainable",
    "load_plugin",
    "load_or_explain",
    "load_method",
    "load_metrics",
    "load_memory_metrics",
    "load_run_metrics",
    "module_file",
    "list_plugins",
    "method_code_hash",
    "metrics_code_hash",
    "plugin_file",
    "plugin_file_methods",
    "resolve",
    "shipped_weights",
    "training_task",
    "untrainable_reason",
    "use_plugin",
    "get_variant",
    "with_broken",
]
