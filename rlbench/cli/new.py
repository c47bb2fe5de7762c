"""The command new: a package with a method of one's own, made from the templates beside it."""

from __future__ import annotations

import importlib.util
import keyword
import re
from pathlib import Path
from string import Template
from typing import Annotated

import typer

from rlbench.cli.options import flag, option
from rlbench.errors import OptionError

TEMPLATES = Path(__file__).parent / "templates"
PACKAGE = "package"  # folder of a template that gets the name of the package
APPENDED = ("README.md", "pyproject.toml")  # files to which a later template adds a part


def new(
    name: Annotated[
        str, typer.Argument(metavar="NAME", help="of the method, its package and its folder")
    ],
    training: Annotated[
        bool, flag(None, "--learned", "a method that learns, and how it is trained")
    ] = False,
    metric: Annotated[bool, flag(None, "--metric", "a metric as well")] = False,
    scene: Annotated[bool, flag(None, "--scene", "a scene as well")] = False,
    out: Annotated[
        Path | None, option(None, "folder to make; default: NAME", value="FOLDER")
    ] = None,
) -> None:
    """Make a package for a method of your own.

    It holds a small method that works, tests, and a README; rlbench check passes at once. The
    package can be installed by pip, or used by --plugin as it is.

    Examples:

    \b
      rlbench new my_method
      rlbench new my_method --learned --metric --scene
      rlbench new my_method --out ~/research/my_method
    """
    from rlbench.system.paths import check_writable
    from rlbench.system.store import write_text

    folder = out or Path(name)
    _check_name(name)
    check_writable(folder)
    if folder.exists():
        raise OptionError(f"{folder} exists already. Choose another NAME, or a folder with --out")
    names = ["common", "learned" if training else "plain"] + ["metric"] * metric
    templates = [TEMPLATES / each for each in names] + ([_scene_template()] if scene else [])
    files = _fill_templates(templates, name)
    for path, text in files.items():
        write_text(folder / path, text)
    third = f"rlbench train -m {name} --quick" if training else f"rlbench run -m {name},mean"
    typer.echo(f"wrote {len(files)} files to {folder}; begin with {name}/method.py. Next:\n")
    for command in (f"cd {folder} && pip install -e .", f"rlbench check {name}", third):
        typer.echo(f"  {command}")


def _check_name(name: str) -> None:
    """Raise OptionError for a name that no new method and no new package can have."""
    from rlbench import registry

    is_word = re.fullmatch(r"[A-Za-z](\w*[A-Za-z0-9])?", name, re.ASCII)
    if not is_word or keyword.iskeyword(name) or name == "all":
        like = re.sub(r"\W+", "_", name, flags=re.ASCII).strip("_0123456789")
        example = like if like and not keyword.iskeyword(like) and like != "all" else "my_method"
        raise OptionError(
            f"'{name}' cannot name a method and its package. Use letters, digits and _ as in the "
            f"name of a Python variable, for example {example}"
        )
    if entry := registry.list_entries("methods").get(name):
        raise OptionError(f"a method '{name}' exists already, in {entry.origin}. Choose another")
    if importlib.util.find_spec(name):
        raise OptionError(
            f"a Python module '{name}' is installed already, and would be imported in place of "
            "your package. Choose another name"
        )


def _scene_template() -> Path:
    """The folder of the app that renders. Raises OptionError where none is installed."""
    from rlbench.registry import apps

    folders: list[Path] = apps.load_parts("scene_template")
    if not folders:
        raise OptionError("--scene: no installed app renders scenes. Run without --scene")
    return folders[0]


def _fill_templates(templates: list[Path], name: str) -> dict[Path, str]:
    """The text of each file of the package, by its path in the package's folder."""
    files: dict[Path, str] = {}
    for template in templates:
        for source in sorted(template.rglob("*.*")):
            parts = source.relative_to(template).parts
            if source.suffix == ".pyc":  # pip compiles what it installs
                continue
            path = Path(*(name if part == PACKAGE else part for part in parts))
            text = Template(source.read_text()).substitute(name=name)
            files[path] = (files.get(path, "") if path.name in APPENDED else "") + text
    return files
