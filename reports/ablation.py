"""The ablation tables: each variant of a family minus the row that it changes, pair by pair."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import pandas as pd

from reports.analysis.differences import (
    VERDICT_NOTE,
    correct_by_holm,
    difference_notes,
    subtract_base,
)
from reports.analysis.rows import (
    check_comparable,
    family_of,
    label_of,
    only_label,
    split_by_device,
    without_label,
)
from reports.analysis.scores import Scores
from reports.layout.page import Section, write_page
from reports.layout.tables import (
    UNCERTAIN_MEANING,
    Record,
    Table,
    format_difference,
    pivot,
    rank_rows,
)
from reports.published import published
from rlbench.benchmark.results import MissingRowsError

PREFERRED = "ours"  # the family of the report if the user names none


def write(
    results: pd.DataFrame, folder: Path, name: str = "ablation", family: str = ""
) -> list[Path]:
    """Write `name`.md, .csv and .tex of `family`, by default ours or that with most variants.

    A variant `family/part-change` is compared with `family/part` where that has scores.

    Rows METHOD@LABEL are left out, unless their families have no rows without a label and there is
    only one label: then these rows are compared, and the title names the label. Raises
    MissingRowsError if the family has scores of its main variant alone, and ReportError if a mean
    would mix rows that cannot be compared.
    """
    label = only_label(set(results["method"]))
    if label:
        results = results.assign(method=results["method"].map(without_label))
    devices = [Scores(rows, device=device) for device, rows in split_by_device(results).items()]
    family = choose_family(devices, family)
    sections = [part for scores in devices if (part := _section(scores, family))]
    title = f"Ablations of {family}" + (f", rows @{label}" if label else "")
    return write_page(folder, name, title, results, sections)


def choose_family(devices: Sequence[Scores], family: str = "") -> str:
    """`family`, else ours, else the family with the most variants.

    Raises MissingRowsError if no device has scores of its main variant and another, or if no family
    has them.
    """
    variants = [item for scores in devices for item in _families_with_scores(scores).items()]
    complete = sorted({name for name, others in variants if others})
    if family and family not in complete:
        raise MissingRowsError(
            f"no device has scores of the main variant of '{family}' and of another variant; "
            f"families with both: {', '.join(complete) or 'none'}; measure them with "
            f"rlbench run --methods '{family}/*'"
        )
    if not complete:
        raise MissingRowsError(
            "no family has scores of its main variant and of another variant on one device; "
            f"measure some with rlbench run --methods '{PREFERRED}/*'"
        )
    largest = max(variants, key=lambda item: (len(item[1]), item[0]))[0]
    return family or (PREFERRED if PREFERRED in complete else largest)


def _families_with_scores(scores: Scores) -> dict[str, list[str]]:
    """Families whose main variant has scores, each with its other variants that have scores."""
    methods = sorted({name for name in scores.measured["method"] if not label_of(name)})
    return {
        main: [name for name in methods if family_of(name) == main and name != main]
        for main in methods
        if main == family_of(main)
    }


def group_by_base(methods: Sequence[str]) -> dict[str, list[str]]:
    """Rows of a family, in groups by the row that they are compared with.

    The base of `family/part-change` is `family/part` if that is among `methods`, else `family`.

    >>> group_by_base(["ours", "ours/A1", "ours/paper", "ours/paper-A1", "ours/latent-A1"])
    {'ours': ['ours/A1', 'ours/latent-A1', 'ours/paper'], 'ours/paper': ['ours/paper-A1']}
    """
    groups: dict[str, list[str]] = {}
    for method in sorted(methods):
        family = family_of(method)
        part = method.rpartition("-")[0]
        while part and part not in methods:
            part = part.rpartition("-")[0]
        if method != family:
            groups.setdefault(part or family, []).append(method)
    return groups


def _section(everything: Scores, family: str) -> Section | None:
    rows = everything.rows[everything.rows["method"].map(family_of) == family]
    scores = replace(everything, rows=rows)
    variants = _families_with_scores(scores).get(family)
    if not variants:
        return None
    check_comparable(rows)
    groups = group_by_base([family, *variants])
    parts = [subtract_base(scores, *group) for group in groups.items()]
    records = correct_by_holm(pd.concat(parts, ignore_index=True))
    tables = [
        table
        for make_table in (_score_table, _time_table, _config_table)
        for base, part in records.groupby("base", sort=False)
        if (table := make_table(scores, part, str(base)))
    ]
    return Section(scores.device, tables, records, _lists(scores, records, family, groups))


def _score_table(scores: Scores, records: pd.DataFrame, base: str) -> Table:
    paper = published()
    of_base = paper.find(base)
    order = rank_rows(records, "difference")
    header, rows = pivot(records, format_difference, order, "variant")
    caption = (
        f"PSNR in dB ({scores.convention}) of each variant minus that of {base}, paired by "
        "scene, clip, frame, budget and seed; mean over scenes. Other trainings would differ too. "
        f"{VERDICT_NOTE}"
    )
    printed = {row[0]: paper.find(row[0]) for row in rows}
    if of_base and any(printed.values()):
        header = (*header, f"paper, {paper.spp:g} spp")
        rows = tuple(
            (*row, f"{p.psnr_db - of_base.psnr_db:+.1f}" if (p := printed[row[0]]) else "-")
            for row in rows
        )
        caption += f" Paper: difference in {paper.source}, {paper.title}."
    return Table(f"PSNR minus that of {base}", caption, header, rows)


def _time_table(scores: Scores, records: pd.DataFrame, base: str) -> Table | None:
    """None if no time was measured."""
    if records["frame_ms"].isna().all():
        return None
    header, rows = pivot(
        records,
        _format_time_difference,
        rank_rows(records, "frame_ms", "lower"),
        "variant",
    )
    caption = (
        "Frame time in ms (G-buffer + plan + allocate + sampling + denoise) minus that of "
        f"{base}, mean over scenes, on {scores.device_name}. Networks are timed on one clip of "
        "each size, in interleaved rounds. Cost of a sample: "
        f"{scores.cost_source or 'not measured'}. {UNCERTAIN_MEANING}."
    )
    return Table(f"Frame time minus that of {base}", caption, header, rows)


def _format_time_difference(row: Record) -> str:
    """The difference of two frame times, with half of its range where an interval is wide."""
    if pd.isna(row["frame_ms"]):
        return "-"
    mark = f" ±{row['frame_range_ms']:.1f}" * bool(row["frame_range_ms"] > 0)
    return f"{row['frame_ms']:+.1f}{mark}"


def _config_table(scores: Scores, records: pd.DataFrame, base: str) -> Table:
    order = rank_rows(records, "difference")
    header, rows = pivot(records, lambda row: str(row["pairs"]), order, "variant")
    texts = scores.measured.drop_duplicates("method").set_index("method")["config"]
    configs = {name: json.loads(texts[name]) for name in (base, *order)}
    lines = tuple((*row, config_changes(configs[row[0]], configs[base])) for row in rows)
    caption = (
        f"Settings that differ between the configs in the results, {base} -> variant; rlbench "
        "list methods shows the question that each variant answers. Numbers: pairs of scores."
    )
    return Table(f"Changed settings of {base}, and pairs", caption, (*header, "settings"), lines)


def config_changes(changed: Mapping[str, object], base: Mapping[str, object]) -> str:
    """The settings in which a config differs from another: `a: 1 -> 2`."""

    def value(config: Mapping[str, object], key: str) -> str:
        return json.dumps(config[key]) if key in config else "-"

    changes = [
        f"{key}: {value(base, key)} -> {value(changed, key)}"
        for key in sorted({*changed, *base})
        if changed.get(key) != base.get(key)
    ]
    return "; ".join(changes) or "no setting in the results"


def _lists(
    scores: Scores, records: pd.DataFrame, family: str, groups: Mapping[str, Sequence[str]]
) -> dict[str, list[str]]:
    compared = set(zip(records["method"], records["target_spp"], strict=True))
    return {
        "Differences": difference_notes(records),
        "Scores without a partner": [
            f"{row['method']} at {row['target_spp']:g} spp: {row['unpaired']} scores without a "
            f"partner, {row['pairs']} pairs"
            for row in records.to_dict("records")
            if row["unpaired"]
        ],
        "Not compared": [
            f"{method} at {spp:g} spp: it or {base} has no score"
            for base, methods in groups.items()
            for method in methods
            for spp in sorted(set(scores.measured["target_spp"]))
            if (method, spp) not in compared
        ],
        "Published variants that were not measured": [
            f"{p.name}, in rlbench {p.row}"
            for p in published().table
            if family_of(p.row) == family != p.row and p.row not in set(records["method"])
        ],
        "Not run": scores.skip_reasons,
        "Uncertain times": scores.uncertain_times,
        "Remarks": scores.remarks,
    }
