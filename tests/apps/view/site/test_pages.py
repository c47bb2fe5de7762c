"""The pages of the results: one for each method and scene, with the numbers of their source."""

from __future__ import annotations

import json
import os
import re

import pytest

from rlbench import registry
from rlbench.apps.view.site import build_pages, preset_scores
from rlbench.apps.view.site.build import VIEWER
from rlbench.apps.view.site.pages import paper_links
from rlbench.benchmark.results import to_dataframe
from tests.reports.conftest import METHODS, rows


def of(baseline, **wanted):
    return [e for e in baseline.entries if all(getattr(e, k) == v for k, v in wanted.items())]


def test_every_row_that_runs_as_shipped_has_a_page_with_its_question_and_its_traits(site, methods):
    pages, _ = site
    shipped = [method for method in methods if not method.is_to_be_trained]
    assert 0 < len(shipped) < len(methods)
    for method in shipped:
        family, _, variant = method.name.partition("/")
        page = pages[f"methods/{family}/{variant or 'index'}.md"]
        assert method.question.split("(")[0].strip() in page.replace("\\", "")
        assert f"rlbench run -m {method.name}" in page
    assert len(shipped) == len([path for path in pages if re.match("methods/.+/", path)])


def test_scores_of_a_method_are_those_of_the_baseline(site, baseline):
    page = site[0]["methods/svgf/index.md"]
    city = of(baseline, method="svgf", scene="city", target_spp=4.0)[0]
    assert f"{city.psnr:.2f}\u00a0±{city.stderr_db:.2f}" in page
    means = [e.psnr for e in of(baseline, method="svgf", target_spp=4.0)]
    assert f"| {sum(means) / 4:.2f} |" in page
    (line,) = [line for line in page.splitlines() if line.startswith("| 4 |")]
    others = {}
    for entry in of(baseline, target_spp=4.0):
        others.setdefault(entry.method, []).append(entry.psnr)
    better = sum(sum(own) > sum(means) for own in others.values() if len(own) == 4)
    assert f"| {better + 1}\u00a0of\u00a0{len(others)} |" in line


def test_a_page_has_the_card_of_its_weights(site, methods):
    (ours,) = [method for method in methods if method.name == "ours"]
    page = site[0]["methods/ours/index.md"]
    assert f"`{ours.card.sha256[:16]}`" in page
    assert f"{ours.card.parameters:,} values" in page


def test_a_picture_is_on_the_pages_of_the_methods_that_it_shows(site):
    pages, _ = site
    assert "](../../results/images.png)" in pages["methods/ours/index.md"]
    assert "images.png" not in pages["methods/svgf/index.md"]


def test_every_shipped_family_has_a_paper_with_a_link():
    assert set(paper_links()) == set(registry.list_plugins("methods"))


def test_a_scene_has_what_it_stands_in_for_its_takes_and_the_scores_of_all_rows(site, baseline):
    page = site[0]["scenes/city.md"]
    assert "Emerald Square" in page
    assert "| `city-cut` | animated | 10 | 15 |" in page
    assert "](city.png)" in page
    for entry in of(baseline, scene="city"):
        assert f"{entry.psnr:.2f}" in page
    assert len({e.method for e in baseline.entries}) == page.count("](../methods/")


def test_every_link_of_a_page_leads_to_a_page_or_a_document(site):
    pages, _ = site
    known = set(pages) | {"results/images.png", "scenes/city.png"}
    for path, text in pages.items():
        targets = re.findall(r"\]\((?!https?:)([^)\s]+)\)", text) if path.endswith(".md") else []
        for target in targets:
            found = os.path.normpath(os.path.join(os.path.dirname(path), target))
            assert found in known or os.path.isfile(f"docs/{found}"), (path, target)


def test_the_navigation_names_every_page(site):
    pages, navigation = site
    named = set(re.findall(r"'([\w/+.-]+\.md)'", repr(navigation)))
    assert named == {path for path in pages if path.endswith(".md")}


def test_the_data_of_a_leaderboard_is_json_with_the_ranking(site, baseline):
    data = json.loads(site[0]["leaderboard/mini.json"])
    (metric,) = data["devices"][0]["table"]["metrics"]
    keys = {(r["method"], r["target_spp"]) for r in metric["records"] if r["scene"] == "all"}
    assert keys == {(entry.method, entry.target_spp) for entry in baseline.entries}
    assert data["traits"]["ours/latent-A2"]["page"] == "../../methods/ours/latent-A2/"
    assert data["traits"]["ours"]["page"] == "../../methods/ours/"


def test_a_leaderboard_imports_the_modules_of_the_viewer_from_this_site_alone(site):
    pages, _ = site
    page = pages["leaderboard/mini.md"]
    imports = json.loads(re.search(r'importmap">(.*?)</script>', page)[1])["imports"]
    assert {f"viewer/{name}" for name in VIEWER} < set(imports)
    for name, path in imports.items():
        assert path == f"../assets/{name.rpartition('/')[2]}"
        assert f"leaderboard/assets/{name.rpartition('/')[2]}" in pages
    used = {
        n for p, t in pages.items() if p.endswith(".js") for n in re.findall(r'"(viewer/\S+)"', t)
    }
    assert used <= set(imports)
    assert "http" not in re.sub(r"http://www.w3.org/\S+", "", page)


@pytest.fixture(scope="module")
def made_up():
    table = to_dataframe(rows())
    return table[table["metric"] != "relmse"].assign(preset="standard", size="64x64")


def test_a_results_folder_gives_times_and_a_board_for_its_preset(made_up, methods, city):
    scores = preset_scores(made_up, "From a folder.")
    pages, _ = build_pages(scores, methods, [city], report="leaderboard/report.html")
    assert (
        "inference 16.5 ms a frame at 1 spp, 64x64, on NVIDIA RTX 2080 Ti"
        in (pages["methods/ours/index.md"])
    )
    assert "](report.html)" in pages["leaderboard/standard.md"]
    assert "None in the results of this site" in pages["methods/svgf/index.md"]
    names = {record["method"] for record in scores[0].records}
    assert names == set(METHODS)


def test_text_of_a_stranger_stays_text(methods, scores, city):
    from dataclasses import replace

    odd = replace(methods[0], name="odd", family="odd", question="<b>|</b> [x](y)")
    page = build_pages(scores, [odd], [city])[0]["methods/odd/index.md"]
    assert r"\<b\>\|\</b\> \[x\](y)" in page
