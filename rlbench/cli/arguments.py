"""Parsers of option values: text becomes a value, or a usage error that says what to write."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass
from functools import wraps
from pathlib import Path
from typing import Any, NamedTuple, NewType, TypeVar

import typer

from rlbench.errors import OptionError

T = TypeVar("T")


class PixelSize(NamedTuple):
    """A size in pixels."""

    height: int
    width: int

    def __str__(self) -> str:
        """As on the command line."""
        return f"{self.width}x{self.height}"


Budgets = NewType("Budgets", tuple[float, ...])  # samples per pixel
Seeds = NewType("Seeds", tuple[int, ...])
PixelSizes = NewType("PixelSizes", tuple[PixelSize, ...])
Crop = NewType("Crop", tuple[int, int, int, int])  # x, y, width, height
Definition = NewType("Definition", tuple[str, str])  # name, value

VIDEO_SIZES = {"720p": "1280x720", "1080p": "1920x1080", "1440p": "2560x1440", "4k": "3840x2160"}


@dataclass(frozen=True)
class WeightsChoice:
    """The value of --weights: a file or "random", and the label of the rows."""

    file: str | None = None  # None for the shipped weights
    label: str = ""
    methods: tuple[str, ...] = ()  # that the file is for; empty: all

    def for_methods(self, names: Collection[str]) -> WeightsChoice:
        """The choice, whose label is a method if it is one of these names."""
        if self.label in names:
            return WeightsChoice(self.file, methods=(self.label,))
        if "/" in self.label:
            raise OptionError(
                f"--weights {self.label}={self.file}: {self.label} is none of the methods of this "
                f"command: {', '.join(names)}"
            )
        return self

    def files_of(self, names: Collection[str]) -> dict[str, str]:
        """The file of each method that has it in place of the shipped one."""
        chosen = self.for_methods(names)
        file = self.file
        return {name: file for name in chosen.methods or names} if file else {}


def text_parser(parse: Callable[[str], T]) -> Callable[[Any], T]:
    """A parser that returns values which are not text, such as defaults, unchanged."""

    @wraps(parse)
    def convert(value: Any) -> T:
        return parse(value) if isinstance(value, str) else value

    return convert


def split_names(values: Iterable[str] | None) -> list[str]:
    """Names given as `a,b`, by repeating the option, or both.

    >>> split_names(["ours,ntas", "svgf"])
    ['ours', 'ntas', 'svgf']
    """
    return [name.strip() for value in values or () for name in value.split(",") if name.strip()]


@text_parser
def parse_budgets(text: str) -> Budgets:
    """Different finite numbers of samples per pixel, above 0.

    >>> parse_budgets("0.5,1,1.0")
    (0.5, 1.0)
    """
    budgets = Budgets(tuple(dict.fromkeys(_number(part) for part in split_names([text]))))
    if not budgets or not all(math.isfinite(spp) and spp > 0 for spp in budgets):
        raise typer.BadParameter(
            f"'{text}' is not a list of budgets. "
            "Give samples per pixel above 0, for example 0.5,1,2"
        )
    return budgets


@text_parser
def parse_train_spp(text: str) -> Budgets:
    """Budgets to train at; empty for `default`, the method's own.

    >>> parse_train_spp("default")
    ()
    """
    return Budgets(()) if text == "default" else parse_budgets(text)


@text_parser
def parse_seeds(text: str) -> Seeds:
    """Different seeds from a list, from ranges without their end, or from both.

    >>> parse_seeds("0:3,7")
    (0, 1, 2, 7)
    """
    seeds: dict[int, None] = {}
    for part in split_names([text]) or [""]:
        first, colon, end = part.partition(":")
        numbers = range(0)
        if re.fullmatch(r"\d+(:\d+)?", part, re.ASCII):
            numbers = range(int(first), int(end) if colon else int(first) + 1)
        if not numbers:
            raise typer.BadParameter(
                f"'{text}' is not a list of seeds. Give a list such as 3,7, or a range such as "
                "0:48, which excludes its end"
            )
        seeds |= dict.fromkeys(numbers)
    return Seeds(tuple(seeds))


@text_parser
def parse_size(text: str) -> PixelSize:
    """Height and width in pixels of WIDTHxHEIGHT.

    >>> parse_size("320x192")
    PixelSize(height=192, width=320)
    """
    match = re.fullmatch(r"([1-9]\d*)x([1-9]\d*)", text, re.ASCII)
    if not match:
        raise typer.BadParameter(f"'{text}' is not a size. Give WIDTHxHEIGHT, for example 320x192")
    return PixelSize(int(match[2]), int(match[1]))


@text_parser
def parse_sizes(text: str) -> PixelSizes:
    """Heights and widths in pixels of a list: 192 is a square; 720p, 1080p and 4k are known.

    >>> [str(size) for size in parse_sizes("192,640x480,1080p")]
    ['192x192', '640x480', '1920x1080']
    """
    squares = (f"{part}x{part}" if part.isdecimal() else part for part in split_names([text]))
    sizes = dict.fromkeys(parse_size(VIDEO_SIZES.get(part, part)) for part in squares)
    if not sizes:
        raise typer.BadParameter(f"'{text}' has no size. Give for example 192,640x480,1080p")
    return PixelSizes(tuple(sizes))


@text_parser
def parse_crop(text: str) -> Crop:
    """Left, top, width and height in pixels of X,Y,WIDTH,HEIGHT.

    >>> parse_crop("16,0,64,48")
    (16, 0, 64, 48)
    """
    if not re.fullmatch(r"\d+(,\d+){3}", text, re.ASCII):
        raise typer.BadParameter(
            f"'{text}' is not a part of a frame. Give X,Y,WIDTH,HEIGHT in pixels"
        )
    x, y, width, height = map(int, text.split(","))
    return Crop((x, y, width, height))


@text_parser
def parse_positive(text: str) -> float:
    """A finite number above 0."""
    if not 0 < (number := _number(text)) < math.inf:
        raise typer.BadParameter(f"'{text}' is not a number above 0")
    return number


@text_parser
def parse_time(text: str) -> float:
    """A finite number of at least 0."""
    if not 0 <= (number := _number(text)) < math.inf:
        raise typer.BadParameter(f"'{text}' is not a time. Give milliseconds, at least 0")
    return number


@text_parser
def parse_share(text: str) -> float:
    """A number between 0 and 1, both excluded."""
    if not 0 < (share := _number(text)) < 1:
        raise typer.BadParameter(
            f"'{text}' is not a share. Give a number between 0 and 1, such as 0.5"
        )
    return share


def _number(text: str) -> float:
    """The number that a text is, or nan."""
    try:
        return float(text)
    except ValueError:
        return math.nan


@text_parser
def parse_keep(text: str) -> str:
    """Which weights of a training are saved: last, best or best:SET."""
    if not re.fullmatch(r"last|best(:.+)?", text):
        raise typer.BadParameter(f"'{text}' is none of last, best and best:SET")
    return text


@text_parser
def parse_age(text: str) -> float:
    """Seconds of a time such as 12h, 30d or 2w.

    >>> parse_age("12h")
    43200.0
    """
    match = re.fullmatch(r"(\d+)([hdw])", text, re.ASCII)
    if not match:
        raise typer.BadParameter(f"'{text}' is not an age. Give hours, days or weeks: 12h, 30d, 2w")
    return float(match[1]) * {"h": 3600, "d": 86_400, "w": 604_800}[match[2]]


@text_parser
def parse_definition(text: str) -> Definition:
    """Name and value of NAME=VALUE.

    >>> parse_definition("max_depth=9")
    ('max_depth', '9')
    """
    name, equals, value = text.partition("=")
    if not name or not equals:
        raise typer.BadParameter(f"'{text}' is no NAME=VALUE, for example max_depth=9")
    return Definition((name, value))


@text_parser
def parse_weights(text: str) -> WeightsChoice:
    """The file and the method or label of NAME=FILE, FILE or `random`."""
    from rlbench.benchmark.results import RESERVED_LABELS

    if text == "random":
        return WeightsChoice(text)
    label, equals, file = text.partition("=")
    if not equals or Path(text).exists():
        label, file = "", text
    elif not re.fullmatch(r"[\w+-]+(/[\w+-]+)?", label, re.ASCII):
        raise typer.BadParameter(
            f"'{label}' is not a method and cannot name rows METHOD@NAME. Use letters, digits, _, "
            "+ and -"
        )
    elif (word := label.partition("-")[0]) in RESERVED_LABELS:
        raise typer.BadParameter(
            f"'{label}' cannot name rows, because METHOD@{word} names rows of another kind. Use "
            "another name before ="
        )
    if Path(file).is_dir():
        inside = ", ".join(str(each) for each in sorted(Path(file).rglob("*.safetensors"))[:3])
        found = f"It holds {inside}" if inside else "It holds no weights (*.safetensors)"
        raise typer.BadParameter(f"'{file}' is a folder, not a weights file. {found}")
    if not Path(file).is_file():
        raise typer.BadParameter(
            f"file '{file}' does not exist. Give a weights file; 'rlbench train' writes one"
        )
    return WeightsChoice(file, label)
