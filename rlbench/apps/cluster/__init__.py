"""Many machines as the engine of a command: --engine ray."""

from rlbench.registry.apps import App

APP = App(engines={"ray": "rlbench.apps.cluster.ray_executor:RayExecutor"})
