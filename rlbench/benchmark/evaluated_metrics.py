"""Metrics that `rlbench evaluate` scores: selected by name and convention, with a hash of each."""

from __future__ import annotations

import importlib.metadata
import re
from collections.abc import Iterable, Sequence
from hashlib import sha256
from typing import Any, NamedTuple

from rlbench import registry
from rlbench.errors import OptionError
from rlbench.system import code_hash, provenance

__all__ = ["EvaluatedMetric", "select_metrics"]

SCORING = (
    "rlbench.benchmark.evaluation",
    "rlbench.benchmark.ground_truth_cache",
    "rlbench.benchmark.scoring",
)  # images to numbers
OF_RUNS = "srgb"  # the convention in which a run scores


class EvaluatedMetric(NamedTuple):
    """A metric under one convention, and a hash of what its scores depend on beside the images."""

    metric: Any  # as metrics.metric.Metric
    content_hash: str

    @property
    def name(self) -> str:
        """The name of its rows, such as psnr or psnr@hable."""
        return str(self.metric.name)


def select_metrics(names: Iterable[str], conventions: Iterable[str] = ()) -> list[EvaluatedMetric]:
    """The named metrics; those that take a convention, under each of `conventions`.

    Without conventions, and under srgb, each metric is as a run scores it. Raises PluginError for
    an unknown metric and for one whose package is not installed, and OptionError for a convention
    that is unknown or that none of the metrics takes.
    """
    loaded = {name: _load(name) for name in dict.fromkeys(names)}
    requested = list(dict.fromkeys(conventions))
    if requested and not any(metric.takes_convention for metric in loaded.values()):
        raise OptionError(
            f"--convention {','.join(requested)}: {', '.join(loaded)} takes no convention. Omit "
            "it, or add a metric such as psnr"
        )
    return [
        EvaluatedMetric(metric, _content_hash(name, metric))
        for name, plain in loaded.items()
        for metric in _variants(plain, requested)
    ]


def _variants(metric: Any, conventions: Sequence[str]) -> list[Any]:
    """The metric under each convention, if it takes one and there are any; else as it is."""
    is_one = not conventions or not metric.takes_convention
    return [metric] if is_one else [_under(metric, convention) for convention in conventions]


def _under(metric: Any, convention: str) -> Any:
    """The metric under a convention; under that of runs it has its plain name."""
    try:
        return metric if convention == OF_RUNS else metric.under(convention)
    except ValueError as error:
        raise OptionError(f"--convention {convention}: {error}") from error


def _load(name: str) -> Any:
    metric = registry.load_or_explain("metrics", name)
    if missing := provenance.missing_packages(metric.requires):
        raise registry.PluginError(
            f"metric '{name}' needs {', '.join(missing)}, which is not installed: pip install "
            f"{_extra_with(missing[0]) or ' '.join(missing)}"
        )
    return metric


def _content_hash(entry: str, metric: Any) -> str:
    """Hash of a metric's code, convention and packages, and of the code that scores images."""
    target = registry.list_entries("metrics")[entry].target.partition(":")[0]
    code = code_hash.code_hash(code_hash.import_closure(target), core=SCORING)
    content = (metric.name, metric.convention, code, provenance.package_versions(metric.requires))
    return sha256(repr(content).encode()).hexdigest()[:16]


def _extra_with(package: str) -> str:
    """The extra of rlbench that installs a package, as pip reads it; empty without one.

    >>> _extra_with("numcodecs")
    "'rlbench[noisebase]'"
    """
    for line in importlib.metadata.requires("rlbench") or ():
        match = re.match(rf"{re.escape(package)}\b.*extra == ['\"](\w+)['\"]", line)
        if match and match[1] != "dev":
            return f"'rlbench[{match[1]}]'"
    return ""
