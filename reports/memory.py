"""The memory table: parameters, work, state and peak memory of each method, beside the paper's.

Reads the table of `rlbench speed` and measures nothing. Command:
python -m reports.memory docs/results
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pandas as pd

from reports.analysis.rows import label_of
from reports.layout.files import folder_argument
from reports.layout.tables import Table, format_number, to_markdown
from reports.published import PublishedMemory, published

BYTES = 4  # of a float32 number
MEGA, MEBI = 1e6, 2**20
INTRODUCTION = (
    "From the table of `rlbench speed` ([speed.csv](speed.csv)); PyTorch in single precision. "
    "*Parameters* and multiply-adds are those of networks that PyTorch runs: `oidn-intel` has 0, "
    "because Intel's library holds its network, and the memory of its layers is not counted. "
    "*State*: all that is kept for the next frame. "
    "*Peak*: most memory of tensors during a frame, beyond its input."
)


def memory_page(speed: pd.DataFrame) -> str:
    """The page as Markdown. `speed` has the columns of speed.csv; rows with a label are left out.

    The image size is the paper's, or else the largest.
    """
    plain = speed[[not label_of(str(name)) for name in speed["method"]]]
    paper = published().memory
    sizes = sorted({(int(h), int(w)) for h, w in plain[["height", "width"]].to_numpy()})
    size = (paper.size, paper.size) if (paper.size, paper.size) in sizes else sizes[-1]
    rows = plain[(plain["height"] == size[0]) & (plain["width"] == size[1])]
    tables = [method_table(rows), *beside_paper(rows, paper)]
    title = f"# Memory and work of a frame: {size[1]} x {size[0]}"
    return "\n\n".join([title, INTRODUCTION, *(to_markdown(t).rstrip() for t in tables)]) + "\n"


def method_table(rows: pd.DataFrame) -> Table:
    """A row for each method at one image size, the least state first, then the least peak."""
    lines = []
    for row in rows.sort_values(["state_bytes", "memory_mb"]).to_dict("records"):
        work = (format_number(row["parameters"], ".0f"), format_number(row["multiply_adds"], ".1f"))
        state = row["state_bytes"] * row["height"] * row["width"] / MEBI
        sizes = (format_number(row["state_bytes"], ".0f"), format_number(state, ".1f"))
        lines.append((f"`{row['method']}`", *work, *sizes, format_number(row["memory_mb"], ".0f")))
    titles = ("thousand parameters", "thousand multiply-adds / pixel")
    head = ("method", *titles, "state, bytes / pixel", "state, MiB", "peak, MiB")
    return Table("By method", "The least state first.", head, tuple(lines))


def beside_paper(rows: pd.DataFrame, paper: PublishedMemory) -> list[Table]:
    """The paper's account of its method, and the same account of ours; empty without our row."""
    ours: list[dict[Any, Any]] = rows[rows["method"] == paper.row].to_dict("records")
    if not ours:
        return []
    row = ours[0]
    inputs = paper.sample_channels + paper.guide_channels
    added = row["state_bytes"] + BYTES * (inputs - paper.earlier_channels)
    pixels = row["height"] * row["width"]
    is_same_size = row["height"] == row["width"] == paper.size
    more = f"state, {paper.sample_channels} channels of samples, {paper.guide_channels} of guides"
    lines = (
        ("state, bytes / pixel", f"{BYTES * paper.state_channels}", f"{row['state_bytes']:.0f}"),
        (f"{more}, beyond earlier methods, bytes / pixel", f"{paper.bytes_per_pixel}",
         f"{added:.0f}"),
        ("the same, of the image, MB", f"{paper.megabytes}" if is_same_size else "-",
         f"{added * pixels / MEGA:.0f}"),
        ("weights, MB", f"< {paper.weights_megabytes}",
         f"{row['parameters'] * 1e3 * BYTES / MEGA:.1f}"),
        ("working memory", paper.working, f"{row['memory_mb'] * MEBI / MEGA:.0f} MB, whole frame"),
    )  # fmt: skip
    caption = (
        f"{published().title}, {paper.source.partition(':')[0]}; state of {paper.state_channels} "
        f"channels. Earlier methods read {paper.earlier_channels} channels; numbers of {BYTES} "
        f"bytes. State here: the latent, accumulated radiance, the last image and G-buffer."
    )
    return [Table("Beside the paper", caption, ("", "paper", f"`{paper.row}` here"), lines)]


def main(folder: Path) -> None:
    """Write memory.md beside the speed.csv of a folder."""
    speed = pd.read_csv(folder / "speed.csv")
    (folder / "memory.md").write_text(memory_page(speed), encoding="utf-8")


if __name__ == "__main__":
    about = "Write memory.md from the speed.csv of `rlbench speed` in the same folder."
    main(folder_argument("memory", about))
