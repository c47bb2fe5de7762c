# ruff: noqa: TID252 - lazy_loader reads relative imports only
from . import metrics
from .api import compare, decide, render_clips, report, run
from .benchmark.listing import list_installed
from .clips.in_memory import InMemoryClip
from .clips.procedural.clip import procedural_clip
from .clips.stored import open_clip
from .denoise import NoisyFrame, denoise
from .errors import RlbenchError
from .family import Family, Traits, Variant
from .frames import Clip, Frame, GBuffer, Pool, Reference, Samples, Size
from .method import Method, State
from .registry.methods import load_method
from .registry.plugin_files import use_plugin
from .run import FrameResult, run_clip, unroll
from .weights import load_for_inference
from .wrappers import MethodWrapper

__all__ = [
    "Clip",
    "Family",
    "Frame",
    "FrameResult",
    "GBuffer",
    "InMemoryClip",
    "Method",
    "MethodWrapper",
    "NoisyFrame",
    "Pool",
    "Reference",
    "RlbenchError",
    "Samples",
    "Size",
    "State",
    "Traits",
    "Variant",
    "compare",
    "decide",
    "denoise",
    "list_installed",
    "load_for_inference",
    "load_method",
    "metrics",
    "open_clip",
    "procedural_clip",
    "render_clips",
    "report",
    "run",
    "run_clip",
    "unroll",
    "use_plugin",
]
