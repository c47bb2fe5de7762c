"""The pages of the results: one for each method and scene, with the numbers of their source."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import pandas as pd
import pytest

from docs.site.boards import make_boards
from docs.site.results_pages import VIEWER, find_papers, make_pages
from docs.site.scene_facts import scene_facts
from rlbench import registry
from rlbench.benchmark.listing import method_facts
from rlbench.benchmark.regression.baseline import find_baseline, load_baseline, to_table
from rlbench.benchmark.results import to_dataframe
from rlbench.clips.presets import GENERATORS, TEST_SCENES
from tests.reports.conftest import METHODS, OFFSET, rows

PSNR_OF_OURS = METHODS["ours"][0] + OFFSET  # at 1 spp, mean over scenes, from formulas
DOCS = Path(__file__).parents[1] / "docs"
IMAGES = {"results/images.png": ("ours", "mean")}
PICTURES = {f"scenes/{name}.png" for name in TEST_SCENES}


@pytest.fixture(scope="module")
def baseline():
    return load_baseline(find_baseline("mini"))


@pytest.fixture(scope="module")
def boards(baseline):
    errors = {entry.key: entry.stderr_db for entry in baseline.entries}
    return make_boards(to_table(baseline), "From the baseline.", errors)


@pytest.fixture(scope="module")
def facts():
    """Those of the methods, and of the scenes."""
    return method_facts(), scene_facts()


@pytest.fixture(scope="module")
def site(boards, facts):
    """Pages by path, and the navigation."""
    return make_pages(boards, *facts, PICTURES, IMAGES)


def test_every_row_that_runs_as_shipped_has_a_page_with_its_question(site, facts):
    (pages, _), (methods, _) = site, facts
    shipped = [method for method in methods if not method.is_to_be_trained]
    assert 0 < len(shipped) < len(methods)
    for method in shipped:
        family, _, variant = method.name.partition("/")
        page = pages[f"methods/{family}/{variant or 'index'}.md"]
        assert method.question in page.replace("\\", "")
        assert f"rlbench run -m {method.name}\n" in page
    assert len(shipped) == len([path for path in pages if re.match("methods/.+/", path)])


def test_scores_of_a_method_are_those_of_the_baseline(site, baseline):
    page = site[0]["methods/svgf/index.md"]
    entries = [entry for entry in baseline.entries if entry.target_spp == 4.0]
    own = {entry.scene: entry for entry in entries if entry.method == "svgf"}
    means = pd.DataFrame(entries).groupby("method")["psnr"].mean()
    cells = next(line for line in page.splitlines() if line.startswith("| 4 |")).split(" | ")
    assert cells[1] == f"{sum(means > means['svgf']) + 1}\u00a0of\u00a0{len(means)}"
    assert cells[2] == f"{means['svgf']:.2f}"
    assert cells[4] == f"{own['city'].psnr:.2f}\u00a0±{own['city'].stderr_db:.2f}"


def test_a_page_has_the_card_of_its_weights_and_the_pictures_that_show_the_method(site, facts):
    (card,) = (method.card for method in facts[0] if method.name == "ours")
    assert f"`{card.sha256[:16]}`" in site[0]["methods/ours/index.md"]
    assert f"{card.parameters:,} values" in site[0]["methods/ours/index.md"]
    shown = {path for path, text in site[0].items() if "(/results/images.png)" in text}
    assert shown == {"methods/ours/index.md", "methods/mean/index.md"}


def test_every_shipped_family_has_a_paper_with_a_link():
    assert set(find_papers()) == set(registry.list_plugins("methods"))


def test_a_scene_has_what_it_stands_in_for_its_takes_and_the_scores_of_all_rows(site, baseline):
    page = site[0]["scenes/city.md"]
    assert "Emerald Square" in page
    assert "| `city-cut` | animated | 10 | 15 |" in page
    assert "](/scenes/city.png)" in page
    assert {f"{e.psnr:.2f}" for e in baseline.entries if e.scene == "city"} <= set(
        re.findall(r"\d+\.\d\d", page)
    )
    assert len({entry.method for entry in baseline.entries}) == page.count("](/methods/")


def test_every_link_leads_to_a_page_or_a_document_and_the_navigation_names_every_page(site):
    pages, navigation = site
    texts = {path: text for path, text in pages.items() if path.endswith(".md")}
    for path, text in texts.items():
        for target in re.findall(r"\]\((?!https?:)([^)\s]+)\)", text):
            found = target.removeprefix("/")
            is_known = found in {*pages, *PICTURES} or (DOCS / found).is_file()
            assert target.startswith("/"), (path, target)
            assert is_known, (path, target)
    assert {f"scenes/{name}.md" for name in (*TEST_SCENES, *GENERATORS)} < set(texts)
    assert set(re.findall(r"'([\w/+.-]+\.md)'", repr(navigation))) == set(texts)


def test_the_data_of_a_leaderboard_is_json_with_the_ranking(site, baseline):
    data = json.loads(site[0]["leaderboard/mini.json"])
    (metric,) = data["devices"][0]["table"]["metrics"]
    keys = {(r["method"], r["target_spp"]) for r in metric["records"] if r["scene"] == "all"}
    assert keys == {(entry.method, entry.target_spp) for entry in baseline.entries}
    assert data["traits"]["ours/latent-A2"]["page"] == "../../methods/ours/latent-A2/"
    assert data["traits"]["ours"]["page"] == "../../methods/ours/"


def test_a_leaderboard_imports_the_modules_of_the_viewer_from_this_site_alone(site):
    pages, _ = site
    imports = json.loads(
        re.search(r'importmap">(.*?)</script>', pages["leaderboard/mini.md"], re.DOTALL)[1]
    )["imports"]
    assert {f"viewer/{name}" for name in VIEWER} < set(imports)
    for path in imports.values():
        assert f"leaderboard/{path.removeprefix('../')}" in pages
    modules = [text for path, text in pages.items() if path.endswith(".js")]
    assert {name for text in modules for name in re.findall(r'"(viewer/\S+)"', text)} <= set(
        imports
    )


PLACES = (
    ("mini", "192x192", "AMD EPYC"),
    ("real", "192x192", "NVIDIA H100"),
    ("real", "640x360", "AMD EPYC"),
    ("real", "640x360", "NVIDIA H100"),
)


@pytest.fixture(scope="module")
def places():
    """Boards of results that differ in preset, size or device; each is a dB above the last."""
    tables = []
    for offset, (preset, size, device) in enumerate(PLACES):
        table = to_dataframe(rows(["ours", "mean"], device))
        table = table[(table["target_spp"] <= 2) & (table["metric"] != "relmse")]
        value = table["value"] + offset * (table["metric"] == "psnr")
        tables.append(table.assign(preset=preset, size=size, value=value))
    return make_boards(pd.concat(tables, ignore_index=True), "From a folder.")


def test_each_preset_size_and_device_has_a_leaderboard_with_its_own_scores(places, facts):
    pages, _ = make_pages(places, *facts, report="leaderboard/report.html")
    titles = [", ".join(place) for place in PLACES]
    assert [board.title for board in places] == titles
    for offset, title in enumerate(titles):
        path = f"leaderboard/{title.lower().replace(', ', '-').replace(' ', '-')}.md"
        assert f"\n# Leaderboard: {title}\n" in pages[path]
        assert "](/leaderboard/report.html)" in pages[path]
        _, at_one = re.findall(r"\d+\.\d\d", pages[path].partition("| [ours]")[2])[:2]
        assert float(at_one) == pytest.approx(PSNR_OF_OURS + offset, abs=0.006)  # two decimals
        for page in ("leaderboard/index.md", "methods/ours/index.md", "scenes/city.md"):
            assert f"[{title}](/{path})" in pages[page]
    cost = "inference 16.5 ms a frame at 1 spp: mini, 192x192, AMD EPYC"
    assert cost in pages["methods/ours/index.md"]
    assert "None in the results of this site" in pages["methods/svgf/index.md"]


def test_text_of_a_stranger_stays_text(facts, boards):
    odd = replace(facts[0][0], name="odd", family="odd", question="<b>|</b> [x](y)")
    page = make_pages(boards, [odd], [])[0]["methods/odd/index.md"]
    assert r"\<b\>\|\</b\> \[x\](y)" in page
