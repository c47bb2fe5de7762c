"""The baseline of the regression check: PSNR per method, scene and budget, in JSON.

Baselines of some presets ship with the package; anyone makes their own from results by `rlbench
regress --update --baseline FILE`. A change of code that alters no quality may still alter the order
of samples, or the rounding of sums that decides between two pixels. Such a rerun is a draw like
that of another seed, so seeds say how far it may fall.
"""

from __future__ import annotations

import json
import math
from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from dataclasses import fields as dataclass_fields
from pathlib import Path
from statistics import fmean, variance
from typing import TYPE_CHECKING, Any, NamedTuple

from rlbench.benchmark.results import COLUMNS, DEFAULTS, WHOLE_CLIP
from rlbench.errors import RlbenchError
from rlbench.system import documents
from rlbench.system.store import write_text

if TYPE_CHECKING:
    import pandas as pd

SHIPPED = Path(__file__).parent / "baselines"
SCHEMA = 3
TOLERANCE_DB = 0.05  # two machines differ by less in float32, a broken method by more
DECIMALS = 4  # of dB, in the file and in the comparison
FALSE_ALARMS = 0.05  # probability that a rerun in another sample order fails any entry
CONVENTION = "peak 1, clipped sRGB, 1.0 = display white, at most 100 dB"  # of metric psnr


class BaselineError(RlbenchError, ValueError):
    """A baseline that cannot be read, or results that cannot be compared with it."""


class ScoreKey(NamedTuple):
    """What a baseline has one PSNR of."""

    method: str  # name of the rows
    scene: str
    target_spp: float  # requested samples per pixel

    def __str__(self) -> str:
        """The key in words, for messages."""
        return f"{self.method} on {self.scene} at {self.target_spp:g} spp"


@dataclass(frozen=True)
class BaselineEntry:
    """PSNR of a method on a scene at a budget: the mean over clips and frames."""

    method: str
    scene: str
    target_spp: float  # requested samples per pixel
    psnr: float  # dB
    tolerance_db: float | None = None  # largest allowed fall; None: the baseline's
    stderr_db: float | None = None  # standard error of the mean over `frames`
    frames: int | None = None  # frames of all clips

    def __post_init__(self) -> None:
        """Raise BaselineError for numbers that no score can be compared with."""
        if not math.isfinite(self.psnr):
            raise BaselineError(f"{self.key} has psnr {self.psnr}; a finite number is required")
        for name in ("target_spp", "tolerance_db", "stderr_db"):
            _check_number(name, getattr(self, name))

    @property
    def key(self) -> ScoreKey:
        """Identity of the entry."""
        return ScoreKey(self.method, self.scene, self.target_spp)


@dataclass(frozen=True)
class Baseline:
    """The expected scores and speeds, and how they were made."""

    preset: str = ""
    command: str = ""
    tolerance_db: float = TOLERANCE_DB  # what machines differ by
    entries: tuple[BaselineEntry, ...] = ()
    seed: int = 0  # of the sample order that the scores are of
    speed: tuple[str, ...] = ()  # gates such as "ours / oidn <= 1.3"

    def __post_init__(self) -> None:
        """Raise BaselineError for a tolerance that no score can exceed."""
        _check_number("tolerance_db", self.tolerance_db)


def shipped_baselines() -> list[str]:
    """Names of the baselines in the package: the presets that they are of.

    >>> shipped_baselines()
    ['mini']
    """
    return sorted(file.stem for file in SHIPPED.glob("*.json"))


def find_baseline(name: str, preset: str = "") -> Path:
    """The file of a shipped baseline, or `name` as a path; an empty name is that of the preset.

    Raises BaselineError if `name` is empty and no baseline of the preset ships.
    """
    if (name or preset) in shipped_baselines():
        return SHIPPED / f"{name or preset}.json"
    if not name:
        raise BaselineError(
            f"no baseline of {f'preset {preset}' if preset else 'these clips'} ships; available: "
            f"{', '.join(shipped_baselines())}. Write your own: rlbench regress --update "
            "--baseline FILE"
        )
    return Path(name)


def load_baseline(path: Path) -> Baseline:
    """The baseline in a JSON file. Raises BaselineError, saying what is wrong with it."""
    try:
        content = documents.read_json(path)
    except FileNotFoundError:
        raise BaselineError(
            f"no baseline at {path}; rlbench regress --update --baseline {path} makes one"
        ) from None
    except (OSError, ValueError) as error:
        raise BaselineError(f"{error}. Restore the file, or pass another --baseline") from None
    schema = content.get("schema") if isinstance(content, dict) else type(content).__name__
    if schema != SCHEMA:
        raise BaselineError(
            f"{path} has schema {schema}, expected {SCHEMA}. Restore the file, or pass another "
            "--baseline"
        )
    try:
        return _decode(content)
    except ValueError as error:
        raise BaselineError(
            f"{path} has a missing, unknown or wrong field: {error}. Correct it, or rewrite the "
            "baseline with rlbench regress --update"
        ) from None


def write_baseline(baseline: Baseline, path: Path) -> None:
    """Write a baseline with one entry a line, so that each changed entry is one changed line."""
    head: dict[str, Any] = {"schema": SCHEMA, **asdict(baseline)}
    entries = [
        {key: value for key, value in entry.items() if value is not None}
        for entry in head.pop("entries")
    ]
    lines = ",\n".join(f"    {json.dumps(entry, allow_nan=False)}" for entry in entries)
    opening = json.dumps(head, indent=2).removesuffix("\n}")
    write_text(path, f'{opening},\n  "entries": [\n{lines}\n  ]\n}}\n')


def _decode(document: dict[str, Any]) -> Baseline:
    """The baseline in a JSON document. Raises ValueError, naming the field that is wrong."""
    fields = {key: value for key, value in document.items() if key != "schema"}
    if missing := sorted({f.name for f in dataclass_fields(Baseline)} - fields.keys()):
        raise ValueError(f"missing keys {', '.join(missing)}")
    _check_keys(fields, Baseline)
    for entry in fields["entries"] if isinstance(fields["entries"], list) else ():
        if isinstance(entry, dict):  # anything else is left for `documents.decode` to refuse
            _check_keys(entry, BaselineEntry)
    return documents.decode(fields, Baseline)


def _check_keys(document: dict[str, Any], kind: type) -> None:
    if unknown := documents.unknown_keys(document, kind):
        raise ValueError(f"unknown keys {', '.join(unknown)}")


def _check_number(name: str, value: float | None) -> None:
    """Every comparison with NaN is false, so no score would ever be worse."""
    if value is not None and not 0 <= value < math.inf:
        raise BaselineError(f"{name} is {value}; a finite number >= 0 is required")


class Score(NamedTuple):
    """PSNR of a method on a scene at a budget, over the frames of all clips."""

    psnr: float  # mean, dB
    stderr_db: float | None  # standard error of the mean over frames; None for one frame
    frames: int


def scores(table: pd.DataFrame, seed: int) -> dict[ScoreKey, Score | None]:
    """The score of each method, scene and budget, or None if a frame has no finite value.

    Frames differ in content and are alike in time, so the standard error describes the clip: how
    well these frames stand for others. It is not what a rerun varies by. Raises BaselineError if
    the results are of several devices, or without `seed`.
    """
    rows = table[table["metric"] == "psnr"]
    if len(devices := sorted(set(rows["device"]) - {""})) > 1:
        raise BaselineError(
            f"the results are of {len(devices)} devices ({', '.join(devices)}). Measure on one "
            "device, into a folder of its own"
        )
    if len(rows) and seed not in (found := seeds(table)):
        raise BaselineError(
            f"the results are of seed {', '.join(map(str, found))}, the baseline is of seed "
            f"{seed}. Measure it too: rlbench run --seed {seed}"
        )
    groups = rows[rows["seed"] == seed].groupby(["method", "scene", "target_spp"])["value"]
    means = groups.agg(lambda values: values.mean(skipna=False))
    return {
        ScoreKey(*key): _score(mean, error, int(frames)) if math.isfinite(mean) else None
        for key, mean, error, frames in zip(
            means.index, means, groups.sem(), groups.size(), strict=True
        )
    }


def _score(mean: float, error: float, frames: int) -> Score:
    return Score(round(mean, DECIMALS), None if frames < 2 else round(error, DECIMALS), frames)


def seeds(table: pd.DataFrame) -> list[int]:
    """The seeds of the sample order that the scores have, sorted."""
    return sorted({int(seed) for seed in table.loc[table["metric"] == "psnr", "seed"]})


def only_preset(table: pd.DataFrame) -> str:
    """The preset of all clips. Raises BaselineError if there are several."""
    presets = sorted(set(table["preset"]))
    if len(presets) > 1:
        names = ", ".join(preset or "none" for preset in presets)
        raise BaselineError(
            f"the results are of {len(presets)} presets ({names}). Measure one preset only"
        )
    return presets[0] if presets else ""


def update_baseline(table: pd.DataFrame, path: Path, methods: Collection[str] = ()) -> Baseline:
    """Rewrite the baseline at `path` from the results of their smallest seed.

    Only the entries of `methods` are rewritten, or all if none are given. Cells that were measured
    with more seeds get a tolerance from them (`allowed_falls`); others keep theirs, as do the
    command, the speed gates and the tolerance between machines. Rewritten entries without a result
    are dropped. Cells that were skipped, such as budgets a method does not support, are left out.
    Raises BaselineError if a frame has no value, if a skipped cell has an entry in the old
    baseline, if entries that stay are of another preset or seed, and as `scores` does.
    """
    old = load_baseline(path) if path.exists() else Baseline()
    kept = [entry for entry in old.entries if methods and entry.method not in methods]
    if methods:
        table = table[table["method"].isin(methods)]
    tolerances = {e.key: e.tolerance_db for e in old.entries if e not in kept}
    found = seeds(table)
    seed = found[0] if found else old.seed
    if kept and (only_preset(table), seed) != (old.preset, old.seed):
        raise BaselineError(
            f"{path} is of preset {old.preset or 'none'} and seed {old.seed}, the results of "
            f"{only_preset(table) or 'none'} and {seed}. Measure those, or rewrite all methods"
        )
    measured = scores(table[table["frame"] != WHOLE_CLIP], seed)
    lost = {key for key, score in scores(table, seed).items() if score is None} & tolerances.keys()
    holes = sorted({key for key, score in measured.items() if score is None} | lost)
    if holes or not measured:
        named = ", ".join(map(str, holes)) or "anything"
        raise BaselineError(f"the results cannot be a baseline: no PSNR of {named}")
    cells = len(kept) + len(measured)
    tolerances |= allowed_falls(_scores_by_seed(table, found), old.tolerance_db, cells)
    entries = [
        BaselineEntry(*key, score.psnr, tolerances.get(key), score.stderr_db, score.frames)
        for key, score in measured.items()
        if score is not None
    ]
    entries = sorted([*kept, *entries], key=lambda entry: entry.key)
    new = replace(old, preset=only_preset(table), seed=seed, entries=tuple(entries))
    write_baseline(new, path)
    return new


def allowed_falls(
    by_seed: Mapping[ScoreKey, Sequence[float]], machine_db: float, cells: int
) -> dict[ScoreKey, float]:
    """The fall in dB that each cell with scores of two or more seeds is allowed.

    It is `machine_db`, plus the largest fall between two sample orders, exceeded in any of `cells`
    with probability 0.05: t s sqrt(2), with s the standard deviation between seeds and t the
    one-sided quantile of Student's distribution at 0.05 / cells (Bonferroni). A few seeds alone
    often give too small an s by chance, so its square is the average of the cell's own and of that
    of its method at the budget, over all scenes, whose degrees of freedom t has (a moderated t:
    Smyth 2004, Statistical Applications in Genetics and Molecular Biology 3, with equal weights).

    >>> cell = ScoreKey("mean", "city", 1.0)
    >>> allowed_falls({cell: [20.0, 20.02]}, machine_db=0.05, cells=1)[cell]
    0.1763
    """
    from scipy.stats import t as student

    repeated = {key: variance(psnrs) for key, psnrs in by_seed.items() if len(psnrs) > 1}
    groups: dict[tuple[str, float], list[ScoreKey]] = defaultdict(list)
    for key in repeated:
        groups[key.method, key.target_spp].append(key)
    falls = {}
    for keys in groups.values():
        weights = [len(by_seed[key]) - 1 for key in keys]
        quantile = float(student.isf(FALSE_ALARMS / cells, sum(weights)))
        pooled = fmean([repeated[key] for key in keys], weights)
        for key in keys:
            fall = quantile * math.sqrt(repeated[key] + pooled)  # s sqrt(2), s^2 their average
            falls[key] = round(machine_db + fall, DECIMALS)
    return falls


def _scores_by_seed(table: pd.DataFrame, found: Sequence[int]) -> dict[ScoreKey, list[float]]:
    """PSNR of each seed, in dB, of the cells that have a score."""
    by_seed: dict[ScoreKey, list[float]] = defaultdict(list)
    for seed in found:
        for key, score in scores(table, seed).items():
            if score:
                by_seed[key].append(score.psnr)
    return by_seed


def to_table(baseline: Baseline) -> pd.DataFrame:
    """The entries as rows of `results.read`: the mean over a scene's frames, as one frame.

    >>> from rlbench.benchmark.regression.baseline import find_baseline, load_baseline
    >>> table = to_table(load_baseline(find_baseline("mini")))
    >>> sorted(set(table["scene"])), set(table["metric"])
    (['city', 'hall', 'ripples', 'temple'], {'psnr'})
    """
    import pandas as pd

    fixed = {
        **DEFAULTS,
        "run_id": f"baseline {baseline.preset}",
        "frame": 0,
        "metric": "psnr",
        "unit": "dB",
        "direction": "higher",
        "convention": CONVENTION,
        "preset": baseline.preset,
        "seed": baseline.seed,
    }
    rows = [
        {
            **fixed,
            "method": entry.method,
            "clip": entry.scene,
            "scene": entry.scene,
            "target_spp": entry.target_spp,
            "mean_spp": entry.target_spp,
            "value": entry.psnr,
        }
        for entry in baseline.entries
    ]
    return pd.DataFrame(rows, columns=list(COLUMNS))
