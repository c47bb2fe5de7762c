"""The engine of a command, by name: this process, or what an installed app adds."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

from rlbench.parallel.executor import LOCAL, Executor, ExecutorError
from rlbench.registry import apps
from rlbench.registry.discovery import resolve
from rlbench.registry.near_names import unknown_name

LOCAL_ENGINE = "local"
QUIET_RAY = {  # environment of Ray, for all that start it
    "RAY_USAGE_STATS_ENABLED": "0",  # by default Ray reports usage statistics
    "RAY_USAGE_STATS_PROMPT_ENABLED": "0",
    "RAY_ENABLE_UV_RUN_RUNTIME_ENV": "0",  # else `uv run` packs and sends the working directory
    "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0",  # else Ray warns that this will be the default
    "RAY_enable_metrics_collection": "0",
    "RAY_DEDUP_LOGS_SKIP_REGEX": ".",  # else Ray prints a page of its log where a machine is lost
}


@contextlib.contextmanager
def open_executor(engine: str = LOCAL_ENGINE) -> Iterator[Executor]:
    """Open the executor of an engine, and close it at the end of the block.

    `engine` is `local`, or NAME or NAME=ADDRESS of an engine of an app. Raises ExecutorError.
    """
    name, has_address, address = engine.partition("=")
    engines = apps.merge_parts("engines")
    if name not in (LOCAL_ENGINE, *engines):
        problem = f"--engine {engine}: no such engine"
        raise ExecutorError(unknown_name(problem, name, (LOCAL_ENGINE, *engines)))
    if name in engines:
        with contextlib.closing(resolve(engines[name])(address or None)) as executor:
            yield executor
    elif has_address:
        raise ExecutorError(f"--engine {engine}: {LOCAL_ENGINE} has no address")
    else:
        yield LOCAL
