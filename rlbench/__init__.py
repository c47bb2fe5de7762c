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

import importlib.util
import sys
import threading
from typing import Any

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def _announce(page: str) -> None:
    """Let Python know a page before its first import, which runs its code at the first use.

    A first import puts the page in the place of the function of the same name: `rlbench.run` is
    `rlbench.api.run`. Unlike `importlib.util.LazyLoader`, questions for `__file__` and the like,
    which torch asks all modules while it is imported, run nothing.
    """
    spec = importlib.util.find_spec(f"{__name__}.{page}")
    module = importlib.util.module_from_spec(spec)
    lock, has_run = threading.RLock(), False

    def run() -> None:
        nonlocal has_run
        with lock:
            if not has_run:
                has_run = True
                try:
                    spec.loader.exec_module(module)
                except BaseException:
                    has_run = False
                    raise

    def run_and_find(name: str) -> Any:
        run()
        if name not in vars(module):
            raise AttributeError(f"module '{spec.name}' has no attribute '{name}'")
        return vars(module)[name]

    def run_and_list() -> list[str]:
        run()
        return sorted(vars(module))

    module.__getattr__, module.__dir__ = run_and_find, run_and_list
    sys.modules[spec.name] = module


for _page in ("run", "denoise"):
    _announce(_page)
