"""One page to look at the results, or at images: flip, layers, time, decide, table; no network."""

from rlbench.apps.view.viewer.opening import choose_opening
from rlbench.apps.view.viewer.page import write, write_gallery

__all__ = ["choose_opening", "write", "write_gallery"]
