"""Looks: a family keeps its colour, and no two methods look the same."""

from __future__ import annotations

from reports.layout.style import COLOURS, line_styles, slug

ZOO = ["ours", "ours/A1", "ours/A2", "ours/small", "ntas", "oidn", "mean", "x", "y/b", "y", "z"]


def test_a_family_keeps_its_colour_whoever_is_beside_it():
    assert line_styles(["ours"])["ours"].color == line_styles(ZOO)["ours"].color == COLOURS["ours"]


def test_variants_share_the_colour_of_their_family():
    assert len({line_styles(ZOO)[name].color for name in ZOO if name.startswith("ours")}) == 1


def test_no_two_methods_look_the_same():
    assert len(set(line_styles(ZOO).values())) == len(ZOO)


def test_as_many_variants_as_ours_has_look_different():
    names = [f"ours/{number}" for number in range(32)]
    assert len({(look.marker, str(look.dash)) for look in line_styles(names).values()}) == 32


def test_families_differ_in_grey_print_too():
    found = line_styles(["ours", "ntas", "oidn", "mean", "svgf", "dasr", "imcd", "restir"])
    assert len({look.marker for look in found.values()}) == 8


def test_a_file_name_is_plain():
    assert slug("NVIDIA H100 80GB/HBM3 (x2)") == "nvidia-h100-80gb-hbm3-x2"
