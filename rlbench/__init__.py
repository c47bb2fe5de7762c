"""rlbench: which adaptive sampler and denoiser gives the least error in a given frame time?

    >>> import rlbench
    >>> clip = rlbench.procedural_clip(seed=1, frames=2)
    >>> method = rlbench.load_method("mean")
    >>> result = next(rlbench.run_clip(method, clip, spp=2.0))
    >>> result.image.shape
    torch.Size([1, 3, 96, 128])

Names are imported when they are first used: `import rlbench` alone takes milliseconds and loads no
torch. The stub beside this file lists them.
"""

import sys
from types import ModuleType
from typing import Any

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


class _Package(ModuleType):
    """This package, in which `rlbench.run` and `rlbench.denoise` are functions always.

    Python would replace them by the submodules of the same names, such as the page
    `rlbench/run.py`, as soon as anything imports these. A module is reached by
    `from rlbench.run import unroll`.
    """

    def __setattr__(self, name: str, value: Any) -> None:
        if not (name in ("run", "denoise") and isinstance(value, ModuleType)):
            super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package
