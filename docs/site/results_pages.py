"""The results as pages: one for each leaderboard, method and scene, from templates of Markdown."""

from __future__ import annotations

import tomllib
from collections.abc import Collection, Mapping, Sequence
from importlib.resources import files
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from docs.site.boards import Board
from rlbench.apps.view.viewer.page import to_json
from rlbench.benchmark.results import mark_uncertainty

if TYPE_CHECKING:
    from docs.site.scene_facts import SceneFacts
    from rlbench.benchmark.listing import MethodFacts

FOLDER = Path(__file__).parent
ASSETS = "leaderboard/assets"  # modules and style, in the documents
VIEWER = ("dom.js", "state.js", "data.js", "copy.js", "table_rows.js", "table_view.js")
SPECIAL = str.maketrans({c: f"\\{c}" for c in "\\`*_[]<>|"})


def make_pages(
    boards: Sequence[Board],
    methods: Sequence[MethodFacts],
    scenes: Sequence[SceneFacts],
    pictures: Collection[str] = (),
    images: Mapping[str, Sequence[str]] | None = None,
    report: str = "",
) -> tuple[dict[str, str], list[Any]]:
    """The content of each page by path, and the navigation of the pages as mkdocs reads it.

    `pictures` are those of scenes, as `scenes/NAME.png`. `images` are the methods that a picture
    shows, by its path. `report` is the path of the viewer's page. Paths are those in the folder of
    documents. Rows that were never trained have no page.
    """
    working = {each.name: each for each in methods if not (each.broken or each.is_to_be_trained)}
    families = {key: list(rows) for key, rows in groupby(working.values(), lambda row: row.family)}
    templates = _environment(
        boards=boards,
        methods=working,
        families=families,
        scenes=scenes,
        pictures=pictures,
        images=images or {},
        report=report,
        papers=find_papers(),
        modules=VIEWER,
    )
    pages = dict(find_modules())

    def write(path: str, template: str, **context: Any) -> str:
        pages[path] = templates.get_template(f"{template}.md.j2").render(context)
        return path

    for board in boards:
        traits = {name: _traits(working[name]) for name in board.methods if name in working}
        pages[f"leaderboard/{board.name}.json"] = to_json({**board.data, "traits": traits})
    return pages, [
        {
            "Leaderboard": [
                write("leaderboard/index.md", "leaderboards"),
                *(
                    {each.title: write(f"leaderboard/{each.name}.md", "leaderboard", board=each)}
                    for each in boards
                ),
            ]
        },
        {
            "Methods": [
                write("methods/index.md", "methods"),
                *(
                    {family: [write(method_path(row.name), "method", method=row) for row in rows]}
                    for family, rows in families.items()
                ),
            ]
        },
        {
            "Scenes": [
                write("scenes/index.md", "scenes"),
                *(write(f"scenes/{each.name}.md", "scene", scene=each) for each in scenes),
            ]
        },
    ]


def find_papers() -> dict[str, str]:
    """Where the paper of a family can be read, by family."""
    return tomllib.loads((FOLDER / "papers.toml").read_text(encoding="utf-8"))


def find_modules() -> dict[str, str]:
    """The modules of the table, which are those of the viewer, and the style, by path."""
    viewer = files("rlbench.apps.view.viewer") / "assets"
    sources = [*(viewer / name for name in VIEWER), *sorted((FOLDER / "assets").iterdir())]
    return {f"{ASSETS}/{path.name}": path.read_text(encoding="utf-8") for path in sources}


def method_path(name: str) -> Markup:
    """The page of a method, `methods/ours/index.md` of ours and `methods/ours/A2.md` of ours/A2."""
    family, _, variant = name.partition("/")
    return Markup(f"methods/{family}/{variant or 'index'}.md")


def _environment(**shared: Any) -> Environment:
    """Templates in which every value is escaped for Markdown unless it is marked as safe."""
    environment = Environment(
        loader=FileSystemLoader(FOLDER / "templates"),
        autoescape=True,
        finalize=_escape,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.globals |= shared
    own = (method_path, mark_uncertainty, unbroken)
    environment.filters |= {each.__name__: each for each in own}
    return environment


def _escape(value: Any) -> Markup:
    """Text that Markdown shows as it is, on one line."""
    if isinstance(value, Markup):
        return value
    return Markup(" ".join(str(value).split()).translate(SPECIAL))


def unbroken(text: str) -> Markup:
    """Numbers that stay on one line, with a minus that is one."""
    return Markup(text.replace("-", "\u2212").replace(" ", "\u00a0"))


def _traits(method: MethodFacts) -> dict[str, Any]:
    """What the table's filters read, and the address of the method's page."""
    page = method_path(method.name).removesuffix(".md").removesuffix("/index")
    return {
        "question": method.question,
        "paper": method.paper,
        "learned": method.learned,
        "adaptive": method.traits.adaptive,
        "temporal": method.traits.temporal,
        "pool": method.traits.pool,
        "inputs": sorted(method.traits.inputs),
        "page": f"../../{page}/",
    }
