"""Repairs of the text of XML scenes that Mitsuba's parser would refuse, each with a note.

Elements that were renamed, spectra of three numbers, rotations that turn nothing, properties given
twice, a missing version, and parameters without a value in parts that rlbench replaces.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Collection
from typing import Any

NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
LOOK_AT = re.compile(r"<(/?)(?:lookAt|LookAt|look_at)\b")
SPECTRUM = re.compile(
    r"<spectrum\b([^<>]*?\bvalue\s*=\s*([\"'])\s*"
    rf"(?:#[0-9a-fA-F]{{6}}|{NUMBER}(?:\s*,\s*|\s+){NUMBER}(?:\s*,\s*|\s+){NUMBER})\s*\2[^<>]*)/>"
)
ROTATE = re.compile(r"<rotate\b([^<>]*)/>")
ATTRIBUTE = re.compile(r"(\w+)\s*=\s*[\"']([^\"']*)[\"']")
DOUBLED = re.compile(
    r"(<(boolean|integer|float|string)\b[^<>]*?\bname\s*=\s*\"([^\"]+)\"[^<>]*/>)"
    r"(?:\s*<\2\b[^<>]*?\bname\s*=\s*\"\3\"[^<>]*/>)+"
)
ROOT = re.compile(r"<scene\b([^<>]*)>")
CAMEL = re.compile(r"\b(?:name|element)\s*=\s*\"[a-z]+[A-Z]")  # names of versions before 2
REPLACED = {  # parts whose settings rlbench replaces, and a plugin of each
    "integrator": "path",
    "sampler": "independent",
    "film": "hdrfilm",
    "rfilter": "box",
}
USED = ("maxDepth", "max_depth")  # of these parts, what rlbench takes from the file
VALUES = {"width": "768", "height": "576", "boolean": "false"}


def repair_syntax(text: str) -> tuple[str, list[str]]:
    """The text as Mitsuba's parser reads it, and notes on what may change the image.

    >>> repair_syntax('<scene version="3.0.0"><spectrum name="a" value="1, 0, 0"/></scene>')[0]
    '<scene version="3.0.0"><rgb name="a" value="1, 0, 0"/></scene>'
    """
    notes = []
    text = LOOK_AT.sub(r"<\1lookat", text)
    text = ROTATE.sub(lambda match: "" if _turns_nothing(match[1]) else match[0], text)
    text, count = SPECTRUM.subn(r"<rgb\1/>", text)
    if count:
        notes.append(f"{count} spectra of three numbers are taken as RGB")
    text, count = DOUBLED.subn(r"\1", text)
    if count:
        notes.append(f"{count} properties are given twice; the first counts")
    root = ROOT.search(text)
    if root and not re.search(r"\bversion\s*=", root[1]):
        version = "0.6.0" if CAMEL.search(text) else "3.0.0"
        text = f"{text[: root.start(1)]} version={version!r}{text[root.start(1) :]}"
        notes.append(f"the file names no version; it is read as {version}")
    return text, notes


def find_replaced(text: str, given: Collection[str]) -> tuple[dict[str, str], list[str]]:
    """Values for the parameters without one in parts that rlbench replaces, and notes.

    `given` are the parameters that have a value. A parameter that another part needs as well stays
    without one, so that Mitsuba refuses it.
    """
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError:
        return {}, []  # Mitsuba's parser says what is wrong
    known = {element.get("name") for element in root.iter("default")} | set(given)
    inside = {id(each) for kind in REPLACED for part in root.iter(kind) for each in part.iter()}
    values: dict[str, str] = {}
    others: set[str] = set()
    for element in root.iter():
        for key, value in element.attrib.items():
            for name in set(re.findall(r"\$(\w+)", value)) - known:
                if id(element) in inside and element.get("name") not in USED:
                    values[name] = _value_for(element, key)
                else:
                    others.add(name)
    values = {name: value for name, value in values.items() if name not in others}
    return values, [f"${name} has no value, and none is needed" for name in values]


def _value_for(element: Any, key: str) -> str:
    if key == "type":
        return REPLACED.get(element.tag, "")
    return VALUES.get(element.get("name", ""), VALUES.get(element.tag, "1"))


def _turns_nothing(attributes: str) -> bool:
    """True for a rotation by 0 about an axis of 0, which Mitsuba refuses."""
    found = dict(ATTRIBUTE.findall(attributes))
    try:
        return not any(float(found.get(name, 0)) for name in ("x", "y", "z", "angle"))
    except ValueError:
        return False
