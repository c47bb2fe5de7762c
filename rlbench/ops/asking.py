"""Whether a tensor may be asked for its values: on a CPU, unless its operations are recorded.

A question, such as `if mask.any()`, costs a CPU nothing and may save work. A GPU works behind the
program that queues its operations, and stops at each question until its answer has arrived; and a
frame whose operations are recorded, to be run again with other values, can answer none. Code that
asks therefore has a second form without questions, and `may_ask` says which of them runs. Both
return the same values up to rounding.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

__all__ = ["is_recorded", "may_ask"]


def is_recorded(values: Tensor) -> bool:
    """True if operations on `values` are recorded, as by torch.compile or in a CUDA graph.

    Every subclass of Tensor counts: a `FakeTensor` has no values, and others stand for tensors
    that something else computes.
    """
    if torch.compiler.is_compiling() or type(values) not in (Tensor, nn.Parameter):
        return True
    return values.is_cuda and torch.cuda.is_current_stream_capturing()


def may_ask(values: Tensor) -> bool:
    """True if control flow may depend on these values.

    >>> mask = torch.tensor([False, True])
    >>> may_ask(mask) and bool(mask.any())
    True
    """
    return values.device.type == "cpu" and not is_recorded(values)
