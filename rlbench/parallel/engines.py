"""The engine of a command, by name: this process, or what an installed package adds."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

from rlbench import registry
from rlbench.parallel.executor import LOCAL, Executor, ExecutorError
from rlbench.registry.near_names import unknown_name

LOCAL_ENGINE = "local"
MAX_RETRIES = 3  # of a job whose worker died
QUIET_ENVIRONMENT = {  # of Ray, for all that start it
    "RAY_USAGE_STATS_ENABLED": "0",  # by default Ray reports usage statistics
    "RAY_USAGE_STATS_PROMPT_ENABLED": "0",
    "RAY_ENABLE_UV_RUN_RUNTIME_ENV": "0",  # else `uv run` packs and sends the working directory
    "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0",  # else Ray warns that this will be the default
    "RAY_enable_metrics_collection": "0",
    "RAY_DEDUP_LOGS_SKIP_REGEX": ".",  # else Ray prints a page of its log where a machine is lost
    "RAY_worker_niceness": "0",  # times are measured at normal priority
    "RAY_task_oom_retries": str(MAX_RETRIES),  # by default Ray retries without end
}


@contextlib.contextmanager
def open_executor(engine: str = LOCAL_ENGINE) -> Iterator[Executor]:
    """Open the executor of an engine, and close it at the end of the block.

    `engine` is `local`, or NAME or NAME=ADDRESS of an entry point in the group
    `rlbench.executors`, which is called with the address, or None, and returns an Executor with a
    method `close`. Raises ExecutorError, and PluginError for one that cannot be imported.
    """
    name, has_address, address = engine.partition("=")
    known = [LOCAL_ENGINE, *registry.list_entries("executors")]
    if name not in known:
        raise ExecutorError(unknown_name(f"--engine {engine}: no such engine", name, known))
    if name != LOCAL_ENGINE:
        with contextlib.closing(registry.load_or_explain("executors", name)(address or None)) as it:
            yield it
    elif has_address:
        raise ExecutorError(f"--engine {engine}: {LOCAL_ENGINE} has no address")
    else:
        yield LOCAL
