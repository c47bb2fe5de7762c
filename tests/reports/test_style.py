"""Line styles: a family keeps its colour, and no two methods have the same style."""

from __future__ import annotations

from reports.layout.style import FAMILY_COLOURS, line_styles, slug

METHODS = [
    "ours",
    "ours/A1",
    "ours/A2",
    "ours/latent-small",
    "ntas",
    "oidn",
    "mean",
    "x",
    "y/b",
    "y",
    "z",
]


def test_a_family_has_one_colour_in_all_figures():
    assert (
        line_styles(["ours"])["ours"].color
        == line_styles(METHODS)["ours"].color
        == FAMILY_COLOURS["ours"]
    )


def test_variants_share_the_colour_of_their_family():
    assert (
        len({line_styles(METHODS)[name].color for name in METHODS if name.startswith("ours")}) == 1
    )


def test_no_two_methods_have_the_same_style():
    assert len(set(line_styles(METHODS).values())) == len(METHODS)


def test_32_variants_have_different_styles():
    names = [f"ours/{number}" for number in range(32)]
    assert len({(style.marker, str(style.dash)) for style in line_styles(names).values()}) == 32


def test_families_differ_in_grey_print_too():
    styles = line_styles(["ours", "ntas", "oidn", "mean", "svgf", "dasr", "imcd", "restir"])
    assert len({style.marker for style in styles.values()}) == 8


def test_a_slug_has_no_special_characters():
    assert slug("NVIDIA H100 80GB/HBM3 (x2)") == "nvidia-h100-80gb-hbm3-x2"
