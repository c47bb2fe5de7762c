"""The sections of the stress suite in their order, each imported when it is run.

Sections outside the core register themselves as entry points of the group `rlbench.stress`.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Iterable
from typing import TYPE_CHECKING

from rlbench import registry
from rlbench.errors import OptionError, PluginError
from rlbench.registry.near_names import unknown_name

if TYPE_CHECKING:
    from rlbench.checks.stress.section import MethodSection, SuiteSection

__all__ = ["CORE_SECTIONS", "list_sections", "load_section", "select_sections"]

FOLDER = "rlbench.checks.stress"
CORE_SECTIONS = {  # module:object by name
    "bad-pixel": f"{FOLDER}.bad_pixel:SECTION",
    "budgets": f"{FOLDER}.budgets:SECTION",
    "allocation": f"{FOLDER}.allocation:SECTION",
    "long-runs": f"{FOLDER}.long_runs:SECTION",
    "precision": f"{FOLDER}.precision:SECTION",
    "transformations": f"{FOLDER}.transformations:SECTION",
    "lying-buffers": f"{FOLDER}.lying_buffers:SECTION",
    "metrics": f"{FOLDER}.metrics:SECTION",
}


def list_sections() -> dict[str, str]:
    """The `module:object` of each installed section by its name, those of the core first.

    Raises PluginError if a plugin has the name of a section of the core.
    """
    core = {name: target for name, target in CORE_SECTIONS.items() if _is_installed(target)}
    plugins = {name: entry.target for name, entry in registry.list_entries("stress").items()}
    if clash := sorted(core.keys() & plugins.keys()):
        raise PluginError(
            f"the stress section '{clash[0]}' of {plugins[clash[0]]} has the name of a section of "
            "rlbench. Rename it"
        )
    return core | plugins


def select_sections(names: Iterable[str] = ()) -> list[str]:
    """The sections with these names, or all, in the order of `list_sections`.

    Raises OptionError for an unknown name.
    """
    installed, selected = list_sections(), list(names)
    if unknown := [name for name in selected if name not in installed]:
        problem = f"--only {','.join(unknown)}: no such section"
        raise OptionError(unknown_name(problem, unknown[0], installed, "; there are"))
    return [name for name in installed if not selected or name in selected]


def load_section(name: str) -> MethodSection | SuiteSection:
    """Import a section.

    Raises PluginError for an object that is no section, or that has another name.
    """
    from rlbench.checks.stress.section import MethodSection, SuiteSection

    target = list_sections()[name]
    section = registry.resolve(target)
    if not isinstance(section, MethodSection | SuiteSection):
        raise PluginError(
            f"{target} is an object of type {type(section).__name__}; a stress section is a "
            "MethodSection or a SuiteSection of rlbench.checks.stress.section"
        )
    if section.name != name:
        raise PluginError(f"{target} has the name '{section.name}', but is registered as '{name}'")
    return section


def _is_installed(target: str) -> bool:
    return importlib.util.find_spec(target.partition(":")[0]) is not None
