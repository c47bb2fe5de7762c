"""Wrong use of a command is one message with exit code 2, and nothing is written."""

from __future__ import annotations

import shlex

import pytest

from tests.cli.runner import rlbench

BEGINNINGS = {  # of commands; `r` are results of mean and eaw with images, and `clips` their clip
    "RUN": "run mean --clips clips",
    "REPORT": "report --results r",
    "EVALUATE": "evaluate r --clips clips",
    "COMPARE": "compare mean eaw --results r",
    "DECIDE": "decide --results r --frame-ms 60000",
    "REGRESS": "regress --results r",
    "TRAIN": "train oidn/retrained --device cpu",
    "CROSSVAL": "crossval ntas --device cpu",
}
MESSAGES = {
    "zz": "No such command 'zz'",
    "methods": "See rlbench list methods",
    "list metheds": "'presets', 'profiles'. Did you mean 'methods'?",
    "list -v -q": "Omit one",
    "check mean --device abacus": "error: device abacus cannot be used on this machine",
    "render --preset minni": "Did you mean 'mini'?",
    "run ours/latent-statless": "Did you mean 'ours/latent-stateless'?",
    "RUN --spp one": "Error: Invalid value for '--spp': 'one' is not a list of budgets",
    "RUN --pool lives": "no pool 'lives'; available: stored, live. Did you mean 'live'?",
    "RUN --takes mains": "'mains' is not one of 'main', 'all'. Did you",
    "RUN --engine steam": "error: --engine steam: no such engine; available: local",
    "RUN --times again --keep-images": "error: --times again: it measures times alone",
    "RUN --out r/run.toml": "Invalid value for '--out'",
    "RUN --size 32x24": "--size applies to preset scenes only",
    "RUN --draws 3 --seed 5": "--draws 3 is --seed 0:3, and --seed was given too",
    "report --results clips": "error: no results in",
    "report summary --results .": "did you mean r?",
    "REPORT zoom": "Did you mean 'zooms'?",
    "REPORT zooms --clips clips --spp 4": "no images at 4 spp",
    "REPORT summary -m mean,svgf": "has no rows of svgf; available: eaw, mean",
    "REPORT summary --against r": "report 'summary' compares no presets",
    "REPORT real": "name results to compare with by --against",
    "REPORT real --against r,r": "another folder has preset",
    "evaluate clips --clips clips": "has no images; `rlbench run --keep-images` makes them",
    "EVALUATE --metrics psnrr": "error: 'psnrr' is not a metric. Did you mean 'psnr'?",
    "EVALUATE --metrics relmse --convention hable": "relmse takes no convention",
    "EVALUATE -m svgf": "no images of svgf on noise; it has eaw, mean on noise",
    "compare mean --results r": "name two rows, for example -m ours,oidn; 1 are named",
    "COMPARE --spp 3": "has no rows of it; available: 1, 2",
    "COMPARE --scenes nose": "available: noise",
    "COMPARE --metric psrn": "metrics that do: ",
    "DECIDE": "--sample-ms or --cost",
    "DECIDE --sample-ms 0": "is not a number above 0",
    "DECIDE --sample-ms 4 --needs albdo": "no such G-buffer channel. Did you mean 'albedo'?",
    "DECIDE --sample-ms 4": "no method has psnr and times on every scene",
    "REGRESS": "error: no baseline of these clips ships; available: mini. Write your own",
    "REGRESS --baseline mini": "the results are of preset none, the baseline of mini",
    "REGRESS --update --baseline mini": "leaves shipped baselines as they are",
    "cache prune --preset unsen": "the cache has no clip of it",
    "cache prune --older-than soon": "'soon' is not an age. Give hours, days or weeks: 12h",
    "cache --dry-run": "select what is removed: rlbench cache prune",
    "TRAIN --seeds 390:402": "--seeds 400, 401: these belong to test set 'unseen'",
    "TRAIN --preset train,mini": "preset 'mini' is a test set",
    "TRAIN --preset mini-640x360": "Choose: train, train-eventful, train-hard, train-real",
    "TRAIN --validate unseen": "--validate unseen: this is a reported test set",
    "TRAIN --clips clips --mix 0.3": "--mix is the share of crops from --clips",
    "TRAIN --mix 1.5 --preset train": "'1.5' is not a share. Give a number between 0 and 1",
    "TRAIN --keep first": "'first' is none of last, best and best:SET",
    "TRAIN --clips clips --holdout hall": "--holdout trains on test scenes of a preset, and",
    "TRAIN --quick --seeds 3": "--quick trains on clips of its own, and --seeds chooses others",
    "TRAIN --status": "error: --status is of a queue",
    "train ntas --train-spp 0.5": "'ntas' cannot be trained at 0.5 spp: supports 1 to 8 spp",
    "train mean,oidn": "error: oidn has weights that Intel trained and published, so rlbench",
    "CROSSVAL --train-spp 0.5": "'ntas' cannot be trained at 0.5 spp",
    "CROSSVAL --max-grad-norm -1": "'-1' is not a number above 0",
    "CROSSVAL --scenes attic": "preset 'mini' has: city, temple, hall",
}


@pytest.mark.parametrize(("words", "message"), MESSAGES.items())
def test_wrong_use_is_one_message_and_writes_nothing(image_run, monkeypatch, words, message):
    monkeypatch.chdir(image_run)
    before = sorted(image_run.rglob("*"))
    first, *others = shlex.split(words)
    output = rlbench(*BEGINNINGS.get(first, first).split(), *others, code=2)
    assert message in output
    assert "Traceback" not in output
    assert sorted(image_run.rglob("*")) == before
