"""One page to look at the results, or at images: flip, layers, time, decide, table; no network."""

from reports.viewer.page import write, write_gallery

__all__ = ["write", "write_gallery"]
