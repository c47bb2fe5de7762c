"""One page to look at the results: decide, flip, layers, time, table. It needs no network."""

from reports.viewer.page import write

__all__ = ["write"]
