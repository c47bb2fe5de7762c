"""Where a number comes from: this machine."""
from __future__ import annotations
import platform
def device(device: object) -> str:
    """x"""
    return platform.processor() or "cpu"
def commit() -> str:
    """x"""
    return ""
