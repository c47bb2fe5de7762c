"""Inference backends: what runs a method or its networks, PyTorch, a compiler, or recorded graphs.

A compiler replaces the `forward` of each network of a method that was loaded for inference; the
rest of the method stays the same. `graph` records the whole stages of a frame for a GPU, `fused`
compiles them first. What a method computes is the same with each.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cache
from importlib.util import find_spec
from typing import TYPE_CHECKING

import torch
from torch import Tensor, nn

from rlbench.errors import OptionError
from rlbench.family import Variant
from rlbench.method import Method
from rlbench.ops.recording import CudaGraphs, Fused, Recorder, can_record
from rlbench.recorded_method import RecordedMethod

if TYPE_CHECKING:
    import openvino

__all__ = [
    "AUTO",
    "BACKENDS",
    "EAGER",
    "applicable_backend",
    "find_networks",
    "require_backend",
    "select_backend",
    "use_backend",
]

EAGER, OPENVINO, COMPILE, GRAPH, FUSED = BACKENDS = (
    "eager",
    "openvino",
    "compile",
    "graph",
    "fused",
)
# backends that record whole stages, and how
RECORDED: dict[str, Callable[[], Recorder]] = {GRAPH: CudaGraphs, FUSED: Fused}
AUTO = "auto"


def select_backend(name: str, device: torch.device) -> str:
    """The backend that a name stands for; `auto` is the fastest that works without a long start.

    That is `graph` on a GPU that replays a small graph, and OpenVINO on a processor that has it,
    or eager. (`fused` may be faster, but compiles for minutes.)

    Raises OptionError for an unknown name, or where the backend cannot be used.
    """
    if name != AUTO:
        require_backend(name, device)
        return name
    if device.type == "cuda":
        return GRAPH if can_record(CudaGraphs(), device) else EAGER
    has_openvino = device.type == "cpu" and find_spec("openvino") is not None
    return OPENVINO if has_openvino else EAGER


def require_backend(name: str, device: torch.device) -> None:
    """Raise OptionError unless the backend exists, is installed and can use the device."""
    if name not in BACKENDS:
        raise OptionError(f"no backend '{name}'; available: {', '.join((AUTO, *BACKENDS))}")
    if name == OPENVINO and find_spec("openvino") is None:
        raise OptionError(
            "--backend openvino needs the package openvino; "
            "to install it: pip install 'rlbench[openvino]'"
        )
    if name == OPENVINO and device.type != "cpu":
        raise OptionError(
            f"--backend openvino runs on the processor, not on {device}; add --device cpu"
        )
    if name in RECORDED and device.type != "cuda":
        raise OptionError(
            f"--backend {name} records CUDA graphs, and cannot run on {device}; add --device cuda"
        )


def applicable_backend(name: str, variant: Variant, *, skips_tiles: bool = False) -> str:
    """The backend that a row uses where `name` is asked for: eager if that one changes nothing.

    Compilers run networks. Graphs have no answers: neither rows that ask (`Traits.eager_reason`)
    nor skipped tiles are recorded.
    """
    if name in RECORDED:
        return EAGER if variant.traits.eager_reason or skips_tiles else name
    return name if variant.learned else EAGER


def use_backend(method: Method, name: str, device: torch.device, half: bool = False) -> Method:
    """The method, whose networks run by a backend from now on; `eager` changes nothing.

    A network is compiled for each input size when it first sees it, which takes up to some seconds
    (`openvino`) or a minute (`compile`). `graph` and `fused` record `plan` and `denoise` for each
    size, see `rlbench.recorded_method`. Outputs differ by rounding. `half` lets OpenVINO compute
    in bfloat16; with the other backends torch.autocast does (`rlbench.wrappers.HalfPrecision`).

    Raises OptionError as `require_backend` does.
    """
    require_backend(name, device)
    if name in RECORDED:
        return RecordedMethod(method, RECORDED[name]())
    for network in find_networks(method):
        if name == OPENVINO:
            network.forward = OpenVinoForward(network, half)
        elif name == COMPILE:
            network.compile(dynamic=False)
    return method


def find_networks(method: object) -> Iterator[nn.Module]:
    """The networks of a method or of the method that it wraps, each once.

    A network is a module with layers that can be called; of nested modules, the outermost one. A
    module whose `forward` branches on values says so by `traceable = False`: compilers follow one
    branch. It stays in PyTorch, and networks inside it are found.
    """
    modules: dict[nn.Module, None] = {}
    for value in getattr(method, "__dict__", {}).values():
        if isinstance(value, nn.Module):
            modules.update(dict.fromkeys(_callable_modules(value)))
        elif isinstance(value, Method):
            modules.update(dict.fromkeys(find_networks(value)))
    yield from modules


def _callable_modules(module: nn.Module) -> Iterator[nn.Module]:
    is_callable = type(module).forward is not nn.Module.forward
    if is_callable and getattr(module, "traceable", True):
        yield from (module,) * any(True for _ in module.children())
    else:
        for child in module.children():
            yield from _callable_modules(child)


@dataclass
class OpenVinoForward:
    """A network's forward by Intel's OpenVINO, compiled for each size of its inputs.

    Inputs become contiguous and float32; outputs are float32, also in bfloat16.
    """

    network: nn.Module
    bf16: bool = False
    _forward: Callable[..., Tensor | list[Tensor]] = field(init=False)  # PyTorch's, to compile from
    _requests: dict[tuple[torch.Size, ...], openvino.InferRequest] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._forward = self.network.forward

    def __call__(self, *inputs: Tensor) -> Tensor | list[Tensor]:
        """The network's output, or the list of its outputs."""
        import openvino

        arrays = [_as_input(each).numpy() for each in inputs]
        sizes = tuple(each.shape for each in inputs)
        if sizes not in self._requests:
            self._requests[sizes] = self._compile(inputs)
        request = self._requests[sizes]
        outputs = [torch.empty(tuple(port.shape)) for port in request.model_outputs]
        for index, output in enumerate(outputs):
            request.set_output_tensor(index, openvino.Tensor(output.numpy(), shared_memory=True))
        request.infer(arrays, share_inputs=True)
        return outputs if len(outputs) > 1 else outputs[0]

    def _compile(self, inputs: tuple[Tensor, ...]) -> openvino.InferRequest:
        import openvino
        from openvino.frontend import FrontEndManager
        from openvino.frontend.pytorch.ts_decoder import TorchScriptPythonDecoder

        # not openvino.convert_model, which sends usage statistics
        examples = tuple(_as_input(each).clone() for each in inputs)
        shapes = [openvino.PartialShape(each.shape) for each in examples]
        with torch.no_grad(), torch.autocast("cpu", enabled=False), warnings.catch_warnings():
            # they say that the size is fixed
            warnings.simplefilter("ignore")
            self.network.forward = self._forward
            try:
                decoder = TorchScriptPythonDecoder(self.network, example_input=examples)
            finally:
                self.network.forward = self
        frontend = FrontEndManager().load_by_framework("pytorch")
        model = frontend.convert(frontend.load(decoder))
        model.reshape(dict(zip(model.inputs, shapes, strict=True)))
        options = {
            "PERFORMANCE_HINT": "LATENCY",
            "INFERENCE_NUM_THREADS": torch.get_num_threads(),
            "INFERENCE_PRECISION_HINT": "bf16" if self.bf16 else "f32",
        }
        return _core().compile_model(model, "CPU", options).create_infer_request()


def _as_input(value: Tensor) -> Tensor:
    value = value.detach().contiguous()
    return value.float() if value.is_floating_point() else value


@cache
def _core() -> openvino.Core:
    import openvino

    return openvino.Core()
