"""Training both networks jointly: bought samples get a gradient that reaches the map."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn import functional as F

from baselines.ntas.method import LOWEST, Ntas, State, untrained
from rlbench.frames import Clip, Size, View
from rlbench.method import Method
from rlbench.ops.transfer import log_forward
from rlbench.run import unroll
from rlbench.sampling import Samples
from rlbench.training import Trainer

SPP = (1.0, 1.5, 2.0, 3.0, 4.0, 6.0)  # budgets drawn in training, samples per pixel
BISECTIONS = 30  # of 32 powers of e, so that the mean is met to float32
