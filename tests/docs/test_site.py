"""The site in a real browser: it is built without a warning, searched and walked."""

import os
import shutil
import subprocess
import sys
import threading
from collections.abc import Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import urldefrag

import pytest

ROOT = Path(__file__).resolve().parents[2]
BROWSER = next(filter(None, map(shutil.which, ("chromium", "google-chrome"))), None)
PHONE, DESK = {"width": 375, "height": 812}, {"width": 1280, "height": 800}
MOST = 200
"""Pages that are walked at most; there are about 50."""

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        BROWSER is None and "CI" not in os.environ,
        reason="chromium is not installed; CI installs it and fails without",
    ),
]


class _Quiet(SimpleHTTPRequestHandler):
    protocol_version = "HTTP/1.1"  # connections that stay open

    def log_message(self, *words: object) -> None:
        """Nothing."""

    def end_headers(self) -> None:
        self.send_header("Cache-Control", "max-age=600")
        super().end_headers()


NO_SEARCH = """window.Worker = class extends EventTarget {
    postMessage() {}
    terminate() {}
}"""
"""Script after which pages do without the search, which reads its index on each."""


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Address of the built site."""
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "-d", str(folder)]
    built = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert built.returncode == 0, built.stderr
    handler = partial(_Quiet, directory=str(folder))
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}/"
        server.shutdown()


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=BROWSER,
            args=["--no-sandbox"],  # root, as in a container, has none
        )
        yield browser
        browser.close()


def _page(browser: Any, size: dict[str, int], complaints: list[str], home: str) -> Any:
    """A page that may ask for nothing but the site, and keeps what goes wrong."""
    page = browser.new_context(viewport=size).new_page()
    page.on("console", lambda message: complaints.append(message.text))
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.on(
        "requestfailed",  # not those that ended as the next page was opened
        lambda request: (
            None
            if request.failure == "net::ERR_ABORTED"
            else complaints.append(request.url[:80])
        ),
    )
    page.on(
        "request",
        lambda request: (
            None
            if request.url.startswith((home, "data:", "blob:"))
            else complaints.append(f"asks for {request.url[:80]}")
        ),
    )
    return page


def test_every_link_within_the_site_leads_somewhere(site: str, browser: Any) -> None:
    """Pages are opened, and their anchors are there; other files are asked for."""
    complaints: list[str] = []
    page = _page(browser, DESK, complaints, site)
    page.add_init_script(NO_SEARCH)
    waiting, seen, wanted = [site + "index.html"], set[str](), dict[str, set[str]]()
    anchors: dict[str, set[str]] = {}
    while waiting and len(seen) < MOST:
        address = waiting.pop()
        if address in seen:
            continue
        seen.add(address)
        if not address.endswith(".html"):
            assert page.request.get(address).status == 200, address
            continue
        answer = page.goto(address)
        assert answer.status == 200, address
        assert page.evaluate(
            "[...document.images].every(i => i.complete && i.naturalWidth)"
        ), f"a picture is missing on {address}"
        ids = page.evaluate("[...document.querySelectorAll('[id]')].map(e => e.id)")
        anchors[address] = set(ids)
        for link in page.evaluate("[...document.links].map(a => a.href)"):
            if not link.startswith(site):
                continue
            target, anchor = urldefrag(link)
            target += "index.html" if target.endswith("/") else ""
            waiting.append(target)
            if anchor:
                wanted.setdefault(target, set()).add(anchor)
    assert complaints == []
    assert 40 < len(anchors) < MOST
    for address, names in wanted.items():
        assert names <= anchors.get(address, names) | {"__codelineno"}, address


def test_search_finds_the_page(site: str, browser: Any) -> None:
    complaints: list[str] = []
    page = _page(browser, DESK, complaints, site)
    page.goto(site + "index.html")
    page.click("label.md-search__icon[for=__search]", force=True)
    page.locator("input.md-search__input").press_sequentially("hindsight")
    # Results are drawn anew at each letter: only locators find the last ones.
    found = page.locator(".md-search-result__item", has_text="hindsight").locator("a")
    found.first.wait_for(timeout=20_000)
    page.wait_for_timeout(1_000)
    found.first.click()
    page.wait_for_load_state("networkidle")
    assert "hindsight" in page.inner_text("article").lower()
    assert complaints == []


@pytest.mark.parametrize("size", [PHONE, DESK], ids=["phone", "desk"])
@pytest.mark.parametrize(
    "name", ["index", "concepts/agents", "results/offline", "reference/tasks/Reach-v0"]
)
def test_pages_are_readable(
    site: str, browser: Any, size: dict[str, int], name: str, tmp_path: Path
) -> None:
    """Nothing is wider than the window but tables, which scroll by themselves."""
    complaints: list[str] = []
    page = _page(browser, size, complaints, site)
    page.goto(f"{site}{name}.html")
    page.wait_for_load_state("networkidle")
    assert page.evaluate("document.documentElement.scrollWidth") <= size["width"]
    small = page.evaluate(
        "[...document.querySelectorAll('article p, article td, article pre code')]"
        ".filter(e => e.offsetParent)"
        ".map(e => parseFloat(getComputedStyle(e).fontSize))"
    )
    assert min(small) >= 11
    pictures = Path(os.environ.get("PICTURES", tmp_path))
    page.screenshot(path=pictures / f"{name.replace('/', '-')}-{size['width']}.png")
    assert complaints == []
