"""The benchmark: a run plan, its runner, scores, latency, cost and the results table.

A run begins with options (`run_options`), which become a plan (`planning`, `run_plan`). It is
measured and stored cell by cell (`runner`), and ends with a verdict (`run_outcome`). `scoring`
turns images into rows, `timing` times, `results` keeps them.

`measure` writes the rows of a plan into a results folder, `read_cells` returns them as a pandas
DataFrame; cells that the folder holds already are not measured again::

    from pathlib import Path

    from rlbench.benchmark.clip_sources import StoredSource
    from rlbench.benchmark.run_plan import RunPlan
    from rlbench.benchmark.runner import measure, read_cells
    from rlbench.clips.rendering import render_preset_clips

    clips = tuple(map(StoredSource, render_preset_clips(["city"], "mini")))
    plan = RunPlan(("ours", "ntas"), clips, spp=(1.0, 4.0))
    folder = Path("results")
    measure(plan, folder, on_cell=lambda cell: print(cell.key))
    rows = read_cells(plan, folder)
    rows[rows["metric"] == "psnr"].groupby(["method", "target_spp"])["value"].mean()

A number is a row; its columns are documented in `results.Row`.
"""
