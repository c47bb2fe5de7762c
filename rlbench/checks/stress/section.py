"""Sections of the stress suite: what one is, the method that its tests run, and which there are.

Sections outside the core register themselves as entry points of the group `rlbench.stress`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import torch

import rlbench
from rlbench import registry
from rlbench.checks.result import CheckResult, failed
from rlbench.checks.stress.wrappers import ResumeRun
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.errors import OptionError, PluginError, RlbenchError
from rlbench.family import Traits
from rlbench.frames import Clip, Size
from rlbench.method import Method
from rlbench.registry.near_names import unknown_name
from rlbench.returns import CheckedReturns
from rlbench.run import FrameResult, run_clip
from rlbench.system import provenance

DEFAULT_SPP = 2.0  # samples per pixel of tests in which the budget does not matter
PROBED_SIZE, PROBED_FRAMES = Size(1, 16, 16), 32  # in which a row shows whether it keeps a state
RETURN_IMAGE = "return a finite image for this input, without an exception"
FOLDER = "rlbench.checks.stress"
CORE_SECTIONS = {  # module:object by name
    "bad-pixel": f"{FOLDER}.bad_pixel:SECTION",
    "budgets": f"{FOLDER}.budgets:SECTION",
    "allocation": f"{FOLDER}.allocation:SECTION",
    "long-runs": f"{FOLDER}.long_runs:SECTION",
    "precision": f"{FOLDER}.precision:SECTION",
    "transformations": f"{FOLDER}.transformations:SECTION",
    "lying-buffers": f"{FOLDER}.lying_buffers:SECTION",
    "metrics": f"{FOLDER}.metrics:SECTION",
}


@dataclass(frozen=True)
class StressedMethod:
    """A method with the weights that it is scored with, its row name and its device."""

    name: str
    method: Method
    device: torch.device

    @property
    def traits(self) -> Traits:
        """The method's traits."""
        return self.method.traits

    @property
    def default_spp(self) -> float:
        """2 samples per pixel, or the nearest budget that the method supports."""
        return self.traits.nearest_spp(DEFAULT_SPP)

    @cached_property
    def keeps_state(self) -> bool:
        """True if the method declares or returns a state, other than the one it was given."""
        if self.traits.temporal:
            return True
        clip = procedural_clip(0, PROBED_SIZE, PROBED_FRAMES, device=self.device)
        given = self.method.start(PROBED_SIZE)
        for result in run_clip(ResumeRun(self.method, given), clip, self.default_spp):
            if result.state is not None and result.state is not given:
                return True
        return False

    def run(
        self, clip: Clip, spp: float | None = None, method: Method | None = None
    ) -> list[FrameResult]:
        """The results of all frames of a clip, at `spp` samples per pixel (None: default_spp).

        `method` is a variation that runs in place of the method.
        """
        return list(run_clip(method or self.method, clip, self.default_spp if spp is None else spp))


@dataclass(frozen=True)
class MethodSection:
    """Tests that run once per method."""

    run: Callable[[StressedMethod, bool], Iterator[CheckResult]]  # the flag selects the quick form


@dataclass(frozen=True)
class SuiteSection:
    """Tests of the suite itself, which run once: metrics, gradient estimators."""

    run: Callable[[bool], Iterator[CheckResult]]  # the flag selects the quick form


def attempt(method: str, test: str, run: Callable[[], CheckResult]) -> CheckResult:
    """The result of a test, also of one that raises; `method` is the name of the row, or ""."""
    try:
        return run()
    except Exception as error:  # whatever a method raises is its result
        return report_exception(method, test, error)


def report_exception(
    method: str, test: str, error: BaseException, remedy: str = RETURN_IMAGE
) -> CheckResult:
    """The failure of a test that raised an exception; names the line that raised it.

    This is the method's own line, if the exception passed through one; else, unless the message
    says what to do, the suite's.
    """
    says_what_to_do = isinstance(error, RlbenchError)
    suite = [] if says_what_to_do else [Path(rlbench.__file__).parent]
    found = f"raised {registry.failure_reason(method, error, *suite)}"
    return failed(test, found, "" if says_what_to_do else remedy)


def unavailable_reason(name: str, weights: str | None = None) -> str | None:
    """Why a method cannot be stressed on this machine, with a file of weights or its own, or None.

    >>> unavailable_reason("mean") is None
    True
    """
    variant = registry.get_variant(name)
    if missing := " ".join(provenance.missing_packages(variant.requires)):
        return f"needs {missing}, which is not installed: pip install {missing}"
    if variant.learned and not weights and not registry.shipped_weights(name).is_file():
        return "has no shipped weights, and random ones say nothing about its stability"
    return None


def load_stressed_method(
    name: str, device: torch.device, weights: str | None = None
) -> StressedMethod:
    """The method with these weights, or those it ships. Raises any exception of its `build`."""
    return StressedMethod(name, CheckedReturns(registry.load_method(name, device, weights)), device)


def list_sections() -> dict[str, str]:
    """The `module:object` of each installed section by its name, those of the core first.

    Raises PluginError if a plugin has the name of a section of the core.
    """
    plugins = {name: entry.target for name, entry in registry.list_entries("stress").items()}
    if clash := sorted(CORE_SECTIONS.keys() & plugins.keys()):
        raise PluginError(
            f"the stress section '{clash[0]}' of {plugins[clash[0]]} has the name of a section of "
            "rlbench. Rename it"
        )
    return CORE_SECTIONS | plugins


def select_sections(names: Iterable[str] = ()) -> list[str]:
    """The sections with these names, or all, in the order of `list_sections`.

    Raises OptionError for an unknown name.
    """
    installed, selected = list_sections(), list(names)
    if unknown := [name for name in selected if name not in installed]:
        problem = f"--only {','.join(unknown)}: no such section"
        raise OptionError(unknown_name(problem, unknown[0], installed, "; there are"))
    return [name for name in installed if not selected or name in selected]


def load_section(name: str) -> MethodSection | SuiteSection:
    """Import a section. Raises PluginError for an object that is not a section."""
    target = list_sections()[name]
    section = registry.resolve(target)
    if not isinstance(section, MethodSection | SuiteSection):
        raise PluginError(
            f"{target} is an object of type {type(section).__name__}; a stress section is a "
            "MethodSection or a SuiteSection of rlbench.checks.stress.section"
        )
    return section
