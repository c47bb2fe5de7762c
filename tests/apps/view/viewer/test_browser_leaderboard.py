"""The leaderboard of the site in a browser: the viewer's table, from data that the site serves."""

from __future__ import annotations

import functools
import http.server
import threading

import pytest

from docs.site.boards import make_boards
from docs.site.results_pages import make_pages
from rlbench.benchmark.listing import method_facts


@pytest.fixture
def address(results, tmp_path):
    """A server of the pages; the Markdown around the table stays as it is."""
    few = results[(results["metric"] == "psnr") & (results["target_spp"] <= 2)]
    boards = make_boards(few.assign(preset="mini", device=""), "From formulas.")
    pages, _ = make_pages(boards, method_facts(), [])
    for path, text in pages.items():
        file = tmp_path / path.replace("/mini.md", "/mini/index.html")
        file.parent.mkdir(parents=True, exist_ok=True)
        is_page = file.suffix == ".html"
        file.write_text(f"<!doctype html><meta charset=utf-8><body>{text}" if is_page else text)
    handler = functools.partial(http.server.SimpleHTTPRequestHandler, directory=tmp_path)
    handler.log_message = lambda *words: None
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler)
    threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True).start()
    yield f"http://127.0.0.1:{server.server_address[1]}/leaderboard/mini/"
    server.shutdown()
    server.server_close()


def test_rows_are_ranked_filtered_and_linked_to_their_pages(browser, address):
    page = browser.new_page()
    problems, requests = [], []
    page.on("pageerror", lambda error: problems.append(str(error)))
    page.on("request", lambda request: requests.append(request.url))
    page.goto(address)
    page.wait_for_selector(".leaderboard[data-ready]")

    def names():
        return [row.get_attribute("data-row") for row in page.query_selector_all("tr[data-row]")]

    assert names() == ["ours", "ours/latent-small", "ntas", "oidn", "mean"]  # at 1 spp, best first
    page.click("[data-filter=adaptive]")
    assert names() == ["ours", "ours/latent-small", "ntas"]
    page.click("[data-sort=method]")
    assert names() == ["ntas", "ours", "ours/latent-small"]
    assert (
        page.get_attribute('tr[data-row="ours/latent-small"] a', "href")
        == "../../methods/ours/latent-small/"
    )
    assert "undefined" not in page.inner_text(".leaderboard")
    page.close()
    assert problems == []
    origin = address.removesuffix("leaderboard/mini/")
    assert all(url.startswith((origin, "data:")) for url in requests)
