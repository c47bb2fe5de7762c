"""The card of a method's shipped weights, from their TOML card and the shipped baseline."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from statistics import fmean
from typing import Any

from rlbench import registry
from rlbench.benchmark.hub_cards.layout import INSTALL, TAGS, TASK, front_matter, hub_licence, table
from rlbench.benchmark.regression.baseline import find_baseline, load_baseline, shipped_baselines
from rlbench.errors import OptionError
from rlbench.weights import ModelCard, read_card

__all__ = ["weights_card"]

WEIGHTS = """# {method}

{title}: {question}

{table}
## Use

```bash
{install}
rlbench run -m {method} --weights FILE.safetensors
```

The card of the training, a TOML file, has to lie beside the weights under the same name.

## Training

{training}
"""


def weights_card(method: str) -> str:
    """The card of a method's shipped weights.

    Raises OptionError for a method without weights, and WeightsError for weights without a card.
    """
    family, variant = registry.load_family(method), registry.get_variant(method)
    if not (variant.learned and variant.pretrained):
        raise OptionError(f"{method} ships no weights. rlbench list methods shows which rows do")
    card = read_card(registry.shipped_weights(method))
    results = _results(method)
    metadata = {
        **hub_licence({card.licence}),
        "library_name": "rlbench",
        "pipeline_tag": TASK,
        "tags": [*TAGS, f"rlbench:{method}"],
        **({"model-index": [{"name": method, "results": results}]} if results else {}),
    }
    traits = variant.traits
    low, high = traits.spp_range
    facts = {
        "Paper": family.paper,
        "Parameters": f"{card.parameters}, stored as {card.dtype}",
        "Reads": f"{', '.join(sorted(traits.inputs)) or 'no G-buffer'}; pool `{traits.pool}`",
        "Samples": "by a density of its own" if traits.adaptive else "equal in all pixels",
        "Budgets": f"{low:g} to {high:g} samples per pixel",
        "SHA-256": f"`{card.sha256}`",
    }
    body = WEIGHTS.format(
        method=method,
        title=family.title,
        question=variant.question,
        table=table(("", ""), list(facts.items())),
        install=INSTALL,
        training=_training(card),
    )
    scores = _scores(results)
    return front_matter(metadata) + body + (f"\n## Scores\n\n{scores}" if scores else "")


def _training(card: ModelCard) -> str:
    lines = [f"Started from: {card.origin}."] if card.origin else []
    if card.steps:
        lines += [
            f"{card.steps} steps on {card.frames_seen} crops of {len(card.data)} clips, "
            f"{card.seconds:.0f} s on {card.device}, seed {card.seed}, commit {card.commit}:",
            f"\n    {card.command}\n",
        ]
    if card.validation_history:
        seen, psnr = card.validation_history[-1]
        lines.append(f"Validation after {seen} crops: {psnr:.2f} dB.")
    lines += [card.note] if card.note else []
    return "\n".join(lines) or "Not known."


def _results(method: str) -> list[dict[str, Any]]:
    """Mean PSNR over scenes at each budget of each shipped baseline, as the hub wants it."""
    results = []
    for name in shipped_baselines():
        own = [e for e in load_baseline(find_baseline(name)).entries if e.method == method]
        metrics = [
            {
                "type": "psnr",
                "name": f"PSNR in dB at {spp:g} spp, mean over scenes",
                "value": round(fmean(e.psnr for e in own if e.target_spp == spp), 2),
            }
            for spp in sorted({entry.target_spp for entry in own})
        ]
        if metrics:
            dataset = {"name": f"rlbench {name}", "type": f"rlbench-{name}"}
            task = {"type": TASK, "name": "Denoising of path-traced frames"}
            results.append({"task": task, "dataset": dataset, "metrics": metrics})
    return results


def _scores(results: Sequence[Mapping[str, Any]]) -> str:
    rows = [
        (each["dataset"]["name"], metric["name"], f"{metric['value']:.2f}")
        for each in results
        for metric in each["metrics"]
    ]
    return table(("clips", "score", "value"), rows) if rows else ""
