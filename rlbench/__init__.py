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

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

# Python knows these pages from here on, and loads them at first use. Else their first import would
# put a page in the place of the function of the same name: `rlbench.run` is `rlbench.api.run`.
for _page in ("run", "denoise"):
    lazy_loader.load(f"{__name__}.{_page}", suppress_warning=True)
