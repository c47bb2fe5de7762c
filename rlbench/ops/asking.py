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

__all__ = ["is_compiling", "is_recorded", "is_recording", "may_ask", "next_age"]


def is_compiling() -> bool:
    """True while torch.compile reads what happens here, which it will fuse.

    One expression over the windows of all pixels then becomes one loop, and takes no memory for
    them. Elsewhere a loop over their taps, in place, takes least.
    """
    return torch.compiler.is_compiling()


def is_recording() -> bool:
    """True while torch.compile or a CUDA graph records what happens here."""
    if is_compiling():
        return True
    # without a driver the second question is an error
    has_begun = torch.cuda.is_initialized()  # type: ignore[no-untyped-call]
    return has_begun and torch.cuda.is_current_stream_capturing()


def is_recorded(values: Tensor) -> bool:
    """True if operations on `values` are recorded, as by torch.compile or in a CUDA graph.

    Every subclass of Tensor counts: a `FakeTensor` has no values, and others stand for tensors
    that something else computes.
    """
    return is_recording() or type(values) not in (Tensor, nn.Parameter)


def may_ask(values: Tensor) -> bool:
    """True if control flow may depend on these values.

    >>> mask = torch.tensor([False, True])
    >>> may_ask(mask) and bool(mask.any())
    True
    """
    return values.device.type == "cpu" and not is_recorded(values)


def next_age(age: int) -> int:
    """The frames that a state has seen, one frame later; where no gradients are, 1 for all of them.

    Truncated backpropagation counts frames. Elsewhere a first frame alone differs from others, so
    that these have states of one kind and are recorded once.
    """
    return age + 1 if torch.is_grad_enabled() else 1
