"""The hash of a method's code, by which stored results are reused or measured again."""

from __future__ import annotations

from hashlib import sha256

from rlbench.registry.discovery import list_entries
from rlbench.registry.lookup import load_family
from rlbench.registry.plugin_files import plugin_file
from rlbench.system import code_hash

__all__ = ["method_code_hash"]


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


def _method_packages() -> set[str]:
    """Top-level packages of installed methods: one method may use parts of another."""
    return {entry.target.partition(".")[0] for entry in list_entries("methods").values()}
