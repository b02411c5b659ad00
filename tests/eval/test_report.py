"""The report: one page that a real browser shows without complaint."""

import base64
import csv
import html
import json
import os
import re
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from marl_mm.cli import main
from marl_mm.datasets.arrays import arrays_of
from marl_mm.datasets.card import card_markdown
from marl_mm.datasets.dataset import load_dataset
from marl_mm.datasets.location import locate
from marl_mm.datasets.provenance import Provenance
from marl_mm.datasets.storage import write_dataset
from marl_mm.episode import Episode
from marl_mm.eval.studies.report import report_page
from marl_mm.eval.tables import markdown_html
from marl_mm.eval.video import write_video

RESULTS = Path(__file__).resolve().parents[2] / "eval/results"
BROWSER = next(filter(None, map(shutil.which, ("chromium", "google-chrome"))), None)
PHONE, DESK = {"width": 375, "height": 812}, {"width": 1280, "height": 800}


@pytest.fixture(scope="module")
def page_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("report") / "report.html"
    assert main(["report", "--results", str(RESULTS), "--out", str(path)]) == 0
    return path


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


@pytest.mark.slow
@pytest.mark.skipif(
    BROWSER is None and "CI" not in os.environ,
    reason="chromium is not installed; CI installs it and fails without",
)
@pytest.mark.parametrize("size", [PHONE, DESK], ids=["phone", "desk"])
def test_a_browser_shows_it_without_complaint(
    page_file: Path, browser: Any, size: dict[str, int]
) -> None:
    context = browser.new_context(viewport=size, offline=True)
    page = context.new_page()
    complaints: list[str] = []
    page.on("console", lambda message: complaints.append(message.text))
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.on("requestfailed", lambda request: complaints.append(request.url[:80]))
    page.goto(page_file.as_uri())
    page.wait_for_load_state("networkidle")
    assert complaints == []
    pictures = page.evaluate(
        "[...document.images].map(i => [i.alt, i.complete, i.naturalWidth])"
    )
    assert len(pictures) == page_file.read_text().count("<img ") > 0
    assert all(complete and width > 100 for _, complete, width in pictures), pictures
    # Nothing is wider than the window but tables, which scroll by themselves.
    assert page.evaluate("document.documentElement.scrollWidth") <= size["width"]
    small = page.evaluate(
        "[...document.querySelectorAll('p, td, th, pre, figcaption')]"
        ".map(e => parseFloat(getComputedStyle(e).fontSize))"
    )
    assert min(small) >= 12  # readable
    # A figure's letters, 8 of 72 to an inch where it is 5 to 12 inches wide, shrink
    # with it: it does not fall below this, and scrolls by itself on a phone.
    shown = page.evaluate("[...document.images].map(i => i.clientWidth)")
    assert min(shown) >= 600
    context.close()


HOSTILE = (
    "![t](http://127.0.0.1:9/picture)",
    "<img src=http://127.0.0.1:9/x onerror=document.title='run'>",
    "<script>document.title='run'</script>",
    "[l](javascript:document.title='run')",
    "<iframe src=http://127.0.0.1:9/frame></iframe>",
    "<style>@import 'http://127.0.0.1:9/style';</style>",
)
"""Names that a stranger may have chosen."""


@pytest.mark.slow
@pytest.mark.skipif(
    BROWSER is None and "CI" not in os.environ,
    reason="chromium is not installed; CI installs it and fails without",
)
def test_a_browser_asks_nobody_and_runs_nothing_for_hostile_names(
    tmp_path: Path, browser: Any, episodes: list[Episode]
) -> None:
    """In the report, and in what a notebook shows of a dataset."""
    rows = tmp_path / "studies" / "rows" / "x"
    rows.mkdir(parents=True)
    names = [*HOSTILE, *(name.replace("[", "a | [") for name in HOSTILE)]
    table = "".join(f'"{name}"\n' for name in names)
    (tmp_path / "studies" / "<img src=x onerror=y>.csv").write_text("setting\n" + table)
    (rows / "a.json").write_text(json.dumps({"name": HOSTILE}))
    location = locate(str(tmp_path / "gift"))
    for number, episode in enumerate(episodes):
        episodes[number] = replace(episode, source=HOSTILE[number % len(HOSTILE)])
    provenance = Provenance(task="Reach-v0", collector=HOSTILE[0])
    write_dataset(location, arrays_of(episodes, location.id), provenance)
    pages = {
        "report.html": report_page(tmp_path),
        "notebook.html": load_dataset(location)._repr_html_(),
        "card.html": markdown_html(card_markdown(load_dataset(location).card())),
    }
    page = browser.new_page()
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    for name, text in pages.items():
        (tmp_path / name).write_text(text)
        page.goto((tmp_path / name).as_uri())
        page.wait_for_load_state("networkidle")
        assert page.title() != "run"
        assert page.locator("iframe, script").count() == 0
        assert "onerror=document.title" in page.inner_text("body")
    outside = [url for url in asked if not url.startswith(("file:", "data:"))]
    assert outside == []
    page.close()


def test_it_needs_nothing_else(page_file: Path) -> None:
    page = page_file.read_text()
    addresses = re.findall(r'(?:src|href)="([^"]{0,40})', page)
    assert addresses
    assert all(one.startswith(("#", "data:")) for one in addresses)
    assert re.findall(r'href="#([^"]+)"', page) == re.findall(
        r'<section id="([^"]+)"', page
    )


def test_every_table_stands_with_what_makes_it(page_file: Path) -> None:
    page = page_file.read_text()
    for command in ("ablate online", "sweep-alpha", "bench control"):
        assert f"marl-mm {command}" in page
    assert "DDPG + HER" in page and "pybullet" in page
    for title in ("best alpha held", "What the runs were made of"):
        assert title in page


def test_every_section_of_results_says_what_makes_it(page_file: Path) -> None:
    page = page_file.read_text()
    sections = re.findall(r'<section id="([^"]+)">(.*?)</section>', page, re.DOTALL)
    described = {name for name, text in sections if re.search(r"</h2>\s*<pre>", text)}
    # What runs were made of, and what drew the page, nothing makes anew.
    assert {name for name, _ in sections} - described == {
        "versions",
        "configs",
    }


def test_films_are_within_the_page(tmp_path: Path) -> None:
    film = tmp_path / "film.mp4"
    write_video(film, [np.full((32, 32, 3), 40 * i, np.uint8) for i in range(4)], 2)
    (tmp_path / "studies").mkdir()
    page = report_page(tmp_path, [film])
    data = base64.b64encode(film.read_bytes()).decode()
    assert (
        f'<video controls preload="metadata" src="data:video/mp4;base64,{data}' in page
    )


def test_results_among_runs_are_found(tmp_path: Path) -> None:
    folder = tmp_path / "studies" / "results"
    folder.mkdir(parents=True)
    (folder / "own.csv").write_text("setting\nMine\n")
    assert "Mine" in report_page(tmp_path)


def test_names_are_text_and_not_html(tmp_path: Path) -> None:
    folder = tmp_path / "studies"
    folder.mkdir()
    (folder / "own.csv").write_text("setting\n<b>Mine</b>\n<script>x</script>\n")
    page = report_page(tmp_path)
    assert "&lt;b&gt;Mine" in page
    assert "<script>" not in page


STUDY = "setting,success\nx,1\n"


@pytest.mark.parametrize(
    "name",
    [
        "studies",
        "studies/foo.csv",
        "studies/foo.png",
        "studies/rows/a",
        "studies/rows/a/b.json",
        "alpha/alpha.png",
        "controller/bench.json",
        "controller/abuse-a.json",
        "env/Reach-v0.json",
    ],
)
def test_a_link_out_of_the_results_shows_nobody_a_file(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    results, out = tmp_path / "results", tmp_path / "report.html"
    for part in ("studies/foo.csv", "alpha/alpha.csv", "studies/rows/a/b.json"):
        (results / part).parent.mkdir(parents=True, exist_ok=True)
        (results / part).write_text(STUDY)
    elsewhere, path = tmp_path / "elsewhere", results / name
    path.parent.mkdir(exist_ok=True)
    if path.exists():
        path.rename(elsewhere)
    else:
        elsewhere.write_text("{}")
    path.symlink_to(elsewhere)
    assert main(["report", "--results", str(results), "--out", str(out)]) == 1
    error = capsys.readouterr().err
    assert "is a link out of its folder" in error and error.count("\n") == 1
    assert not out.exists()


def test_links_within_the_results_are_followed(tmp_path: Path) -> None:
    (tmp_path / "studies").mkdir()
    (tmp_path / "foo.csv").write_text(STUDY)
    (tmp_path / "studies/foo.csv").symlink_to(tmp_path / "foo.csv")
    assert "<th>setting</th>" in report_page(tmp_path)


@pytest.mark.parametrize("part", ["studies/foo.csv", "alpha/alpha.csv"])
@pytest.mark.parametrize(
    "text",
    [
        "[c](http://evil)",
        "<http://x>",
        "[c][d]",
        "x\n\n# HEAD",
        "x\n| a | b |",
        "x\u2028# HEAD",
        r"a|b \|c \\|d",
        "*a* _b_ `c` ~~d~~",
        "&lt;b&gt; &#60;",
        "<b>",
        "d_mm [m]",
    ],
)
def test_cells_and_heads_are_shown_as_they_are(
    text: str, part: str, tmp_path: Path
) -> None:
    (tmp_path / part).parent.mkdir()
    with (tmp_path / part).open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerows([["setting", text], [text, "y"]])
    page = report_page(tmp_path)
    (table,) = re.findall(r"<table>.*?<td>y</td>.*?</table>", page, re.DOTALL)
    cells = re.findall(r"<t[hd]>(.*?)</t[hd]>", table)
    shown = " ".join(text.splitlines())
    assert [html.unescape(cell) for cell in cells] == ["setting", shown, shown, "y"]
    assert page.count("<h1>") == 1 and 'href="http' not in page
    assert not re.search("<(a|b|em|code)>", table)


def test_names_of_files_make_no_link(tmp_path: Path) -> None:
    folder = tmp_path / "controller"
    folder.mkdir()
    for path in (RESULTS / "controller").glob("abuse-*.json"):
        shutil.copy(path, folder / "abuse-[c](http:evil)<http:x>.json")
    assert 'href="http' not in report_page(tmp_path)


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["--results", "nothing"], "nothing has no results"),
        (["--videos", "none.mp4"], "cannot read none.mp4: No such file"),
        (["--videos", "film.txt"], "neither a picture nor a video"),
    ],
)
def test_what_cannot_be_shown_is_told(
    words: list[str],
    complaint: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    results = [] if "--results" in words else ["--results", str(RESULTS)]
    assert main(["report", *results, *words]) == 2
    assert complaint in capsys.readouterr().err
    assert not (tmp_path / "runs/report.html").exists()
