"""The board: submissions by task and data, with tie groups, as a browser shows it."""

import csv
import json
import os
import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import marl_mm
from marl_mm.cli import main
from marl_mm.errors import OutputExistsError, SubmissionError, UsageError
from marl_mm.files import write_json
from marl_mm.runs import board as boards
from marl_mm.runs import submit as submitting
from marl_mm.runs.folder import CONFIG, EVALUATION
from marl_mm.runs.play import Film, play
from marl_mm.runs.submission import EPISODES, MANIFEST, scored, seal
from marl_mm.runs.submission_checks import read_submission
from marl_mm.runs.verification import verification_file
from tests.runs.tampering import edit, manifest, seal_again

BROWSER = next(filter(None, map(shutil.which, ("chromium", "google-chrome"))), None)
pytestmark = pytest.mark.slow

PHONE, DESK = {"width": 375, "height": 812}, {"width": 1280, "height": 800}

TRAINED: dict[str, Any] = {
    "hidden": (32, 32),
    "batch_size": 64,
    "eval_episodes": 2,
    "curve_episodes": 1,
    "max_steps": 20,
    "engine": "mujoco",
}


@pytest.fixture(scope="module")
def submissions(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Cloning by agents and jointly, which reach most goals, one that reaches none.

    The last one is on other goals.
    """
    folder = tmp_path_factory.mktemp("board")
    for name, algorithm, updates in (
        *(("agents", "mabc", 400), ("joint", "bc", 400)),
        *(("none", "mabc", 1), ("others", "mabc", 400)),
    ):
        if name != "others":
            marl_mm.train(
                algorithm,
                "good-5k",
                out=folder / "runs" / name,
                seeds=(0, 1, 2),
                updates=updates,
                curve_every=updates,
                **TRAINED,
            )
        runs = [folder / "runs" / name.replace("others", "agents") / s for s in "012"]
        episodes, seed = (2, 1) if name == "others" else (8, 0)
        marl_mm.submit(runs, out=folder / name, episodes=episodes, seed=seed)
    marl_mm.verify(folder / "agents")
    return [folder / name for name in ("none", "agents", "others", "joint")]


@pytest.fixture(scope="module")
def made(submissions: list[Path]) -> Any:
    return marl_mm.board(submissions, out=submissions[0].parent / "page")


def test_entries_of_other_goals_are_never_mixed(made: Any) -> None:
    names = [[e.submission.folder.name for e in section] for section in made.sections]
    assert [len(section) for section in names] == [3, 1]  # most entries first
    assert names[1] == ["others"]


@pytest.mark.parametrize("what", ["data", "engine", "goals", "steps"])
def test_what_is_of_another_setting_stands_apart(
    what: str,
    submissions: list[Path],
    tmp_path: Path,
) -> None:
    others, copy = submissions[2], tmp_path / "copy"
    if what in ("goals", "steps"):
        run = shutil.copytree(others.parent / "runs/agents/0", tmp_path / "run")
        edit(run / CONFIG, lambda v: v.update(max_steps=20 if what == "goals" else 9))
        marl_mm.submit(run, out=copy, episodes=2, seed=2 if what == "goals" else 1)
    else:
        shutil.copytree(others, copy)
        data, engine = {"fingerprint": "0" * 16}, {"engine_version": "9.9"}
        for seed in "012":
            if what == "data":
                edit(copy / seed / CONFIG, lambda v: v["dataset"].update(data))
            else:
                edit(copy / seed / EVALUATION, lambda v: v.update(engine))
        version = {"mujoco-core": "9.9"} if what == "engine" else {}
        manifest(lambda v: v["packages"].update(version))(copy)
        seal_again(copy)
    sections = marl_mm.board([others, copy], out=tmp_path / "page").sections
    assert [len(section) for section in sections] == [1, 1]


def test_the_page_shows_what_is_claimed(made: Any) -> None:
    text = " ".join(made.page.read_text().split())
    for entry in (entry for section in made.sections for entry in section):
        claims = entry.submission.manifest["claims"]
        rates = ", ".join(f"{100 * rate:.1f}" for rate in claims["success_seeds"])
        assert f'<td class="number">{rates}</td>' in text
        for name, scale, digits in (("success", 100, 1), ("return", 1, 2)):
            mean, low, high = (
                f"{scale * value:.{digits}f}"
                for value in (claims[name], *claims[f"{name}_interval"])
            )
            assert f'{mean} <span class="quiet">[{low}, {high}]</span>' in text
        if entry.verification:
            success = f"{100 * entry.verification['success']:.1f} %"
            assert f'title="scored again: equal to the bit; success {success}"' in text
    assert "<dt>batch_size</dt><dd>64</dd>" in text and "<dt>max_steps" not in text
    assert "film" not in text


def test_no_cell_of_the_rows_is_a_formula(submissions: list[Path]) -> None:
    folder = shutil.copytree(submissions[0], submissions[0].parent / "formula")
    path, hashes = folder / "0" / EVALUATION, folder / "0" / EPISODES
    values = json.loads(path.read_text())
    for row in values["episodes"]:
        row |= {"direction": "=1+1", "@SUM": 1.0, "algorithm": 2.0}
    write_json(path, values)
    values = json.loads(hashes.read_text())
    write_json(hashes, values | {"sha256": ["+1"] * len(values["sha256"])})
    seal_again(folder, claims=False)
    page = marl_mm.board([folder], out=folder.parent / "plain").page
    (rows,) = (page.parent / "rows").iterdir()
    row = next(csv.DictReader(rows.open()))
    assert (row["direction"], row["sha256"], row["'@SUM"]) == ("'=1+1", "'+1", "1")
    assert row["algorithm"] == "mabc" and next(iter(row)) == "algorithm"
    assert not row["goal"].startswith("'")


def test_those_that_cannot_be_told_apart_share_a_group(made: Any) -> None:
    (section,) = [section for section in made.sections if len(section) == 3]
    groups = {entry.submission.folder.name: entry.groups for entry in section}
    assert groups == {"agents": (1,), "joint": (1,), "none": (2,)}
    assert section[-1].submission.folder.name == "none"


def test_a_verdict_is_of_the_submission_that_was_scored(
    made: Any, submissions: list[Path], tmp_path: Path
) -> None:
    verdicts = {
        entry.submission.folder.name: entry.verification
        for section in made.sections
        for entry in section
    }
    assert verdicts["agents"]["verdict"] == "equal to the bit"
    assert verdicts["joint"] is None
    copy = tmp_path / "joint"
    shutil.copytree(submissions[3], copy)
    shutil.copy(verification_file(submissions[1]), verification_file(copy))
    board = marl_mm.board([copy], out=tmp_path / "page")
    assert board.sections[0][0].verification is None
    assert "not verified" in board.page.read_text()


def test_a_verdict_that_is_damaged_is_named(
    submissions: list[Path],
    tmp_path: Path,
) -> None:
    copy = shutil.copytree(submissions[2], tmp_path / "copy")
    record = {"fingerprint": read_submission(copy).fingerprint, "verdict": 3}
    write_json(verification_file(copy), record)
    with pytest.raises(SubmissionError, match=r"verified\.json: verdict: int is not"):
        marl_mm.board([copy], out=tmp_path / "page")


@pytest.mark.parametrize(("count", "kind"), [(11, "open"), (12, "good")])
def test_a_verdict_of_few_episodes_is_not_green(
    count: int, kind: str, submissions: list[Path], tmp_path: Path
) -> None:
    copy = shutil.copytree(submissions[1], tmp_path / "agents")
    record = json.loads(verification_file(submissions[1]).read_text())
    write_json(verification_file(copy), record | {"scored": count})
    page = marl_mm.board([copy], out=tmp_path / "page").page.read_text()
    assert re.search(rf'class="{kind}"[^>]*>verified, {count} of 24', page)


def test_what_is_not_as_it_claims_is_last_and_in_no_group(
    submissions: list[Path], tmp_path: Path
) -> None:
    copies = [
        shutil.copytree(folder, tmp_path / folder.name)
        for folder in submissions
        if folder.name != "others"
    ]
    record = json.loads(verification_file(submissions[1]).read_text())
    write_json(
        verification_file(tmp_path / "agents"), record | {"verdict": "not equal"}
    )
    (section,) = marl_mm.board(copies, out=tmp_path / "page").sections
    groups = [(entry.submission.folder.name, entry.groups) for entry in section]
    assert groups == [("joint", (1,)), ("none", (2,)), ("agents", ())]


def test_rows_are_there_to_be_downloaded(made: Any) -> None:
    links = re.findall(r'href="(rows/[^"]+)"', made.page.read_text())
    assert len(links) == 4
    for link in links:
        with (made.page.parent / link).open(newline="") as file:
            rows = list(csv.DictReader(file))
        assert len(rows) in (3 * 8, 3 * 2)
        assert {len(row["sha256"]) for row in rows} == {64}
        assert {row["run"] for row in rows} == {"0", "1", "2"}


def test_the_same_submission_twice_is_refused(
    submissions: list[Path], tmp_path: Path
) -> None:
    with pytest.raises(UsageError, match="are the same"):
        marl_mm.board([submissions[0]] * 2, out=tmp_path / "page")
    (tmp_path / "mine").mkdir()
    with pytest.raises(UsageError, match=r"has no index\.html of marl-mm and"):
        marl_mm.board(submissions[:1], out=tmp_path / "mine", overwrite=True)
    board = marl_mm.board(submissions[:1], out=tmp_path / "page")
    (board.page.parent / "rows/notes.md").touch()
    with pytest.raises(UsageError, match=r"holds rows/notes\.md, which is not of"):
        marl_mm.board(submissions[:1], out=tmp_path / "page", overwrite=True)


def test_verdicts_among_the_folders_are_left_out_and_these_are_kept(
    submissions: list[Path], tmp_path: Path
) -> None:
    here = tmp_path / "here"
    mine = shutil.copytree(submissions[0], here / "mine")
    marl_mm.verify(mine)
    board = marl_mm.board(sorted(here.iterdir()), out=here / "page")
    assert sum(map(len, board.sections)) == 1
    shutil.copytree(mine, here / "page/mine")
    for folder, out in ((mine, mine / "page"), (here / "page/mine", here / "page")):
        with pytest.raises(UsageError, match=r"over or into|holds mine/.*, which is"):
            marl_mm.board(read_submission(folder), out=out, overwrite=True)


@pytest.mark.parametrize("name", ["board", "submit"])
def test_what_another_process_wrote_meanwhile_stays(
    name: str,
    submissions: list[Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    module, inner = {"board": (boards, "_page"), "submit": (submitting, "seal")}[name]
    work, mine = getattr(module, inner), tmp_path / "out/mine"

    def beside_another(*given: Any) -> Any:
        mine.parent.mkdir()
        mine.touch()
        return work(*given)

    monkeypatch.setattr(module, inner, beside_another)
    with pytest.raises(OutputExistsError):
        if name == "board":
            marl_mm.board(submissions[2], out=mine.parent)
        else:
            run = submissions[2].parent / "runs/agents/0"
            marl_mm.submit(run, out=mine.parent, episodes=1)
    assert [*tmp_path.rglob("*")] == [mine.parent, mine]


# --- In a browser ------------------------------------------------------------


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


needs_browser = pytest.mark.skipif(
    BROWSER is None and "CI" not in os.environ,
    reason="chromium is not installed; CI installs it and fails without",
)


def opened(browser: Any, path: Path, complaints: list[str], **context: Any) -> Any:
    """The page without a network, which keeps what goes wrong."""
    page = browser.new_context(offline=True, **context).new_page()
    page.on("console", lambda message: complaints.append(message.text))
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.on("requestfailed", lambda request: complaints.append(request.url[:80]))
    page.goto(path.as_uri())
    page.wait_for_load_state("networkidle")
    return page


@needs_browser
@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("size", [PHONE, DESK], ids=["phone", "desk"])
def test_a_browser_shows_and_filters_it(
    made: Any, browser: Any, size: dict[str, int], scheme: str, tmp_path: Path
) -> None:
    complaints: list[str] = []
    context = {"viewport": size, "color_scheme": scheme}
    page = opened(browser, made.page, complaints, **context)
    pictures = Path(os.environ.get("PICTURES", tmp_path))
    picture = pictures / f"board-{size['width']}-{scheme}.png"
    page.screenshot(path=picture, full_page=True)
    assert page.evaluate("document.documentElement.scrollWidth") <= size["width"]
    rows, sections = page.locator("tbody tr:visible"), page.locator("section:visible")
    assert (rows.count(), sections.count()) == (4, 2)
    page.select_option("select[name=algorithm]", "bc")
    assert (rows.count(), sections.count()) == (1, 1)
    page.select_option("select[name=algorithm]", "")
    assert (rows.count(), sections.count()) == (4, 2)
    assert complaints == []


@needs_browser
def test_a_browser_runs_nothing_of_a_strangers_texts(
    submissions: list[Path], browser: Any, tmp_path: Path
) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(submissions[0], copy)
    values = json.loads((copy / MANIFEST).read_text())
    script = "<script>document.title='run'</script><img src=x onerror=alert(1)>\""
    values["machine"]["processor"] = script
    write_json(copy / MANIFEST, values | {"fingerprint": seal(values)})
    board = marl_mm.board([copy], out=tmp_path / "page")
    complaints: list[str] = []
    page = opened(browser, board.page, complaints)
    assert page.title() == "marl_mm: board"
    assert page.locator("script").count() == 1 and page.locator("img").count() == 0
    assert complaints == []


@pytest.mark.bullet
@needs_browser
def test_films_stand_beside_the_page(
    submissions: list[Path],
    browser: Any,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Each is of an episode that was scored."""
    films: list[Film] = []

    def kept(*given: Any, **settings: Any) -> Film:
        films.append(play(*given, **settings))
        return films[-1]

    monkeypatch.setattr(boards, "_FILM_FPS", 1)
    monkeypatch.setattr(boards, "play", kept)
    out = tmp_path / "page"
    words = ["board", str(submissions[0]), "--out", str(out), "--films"]
    assert main(words) == 0
    (run, *_) = read_submission(submissions[0]).runs
    assert scored(films[0].episode).sha256 in {e.sha256 for e in run.episodes}
    complaints: list[str] = []
    page = opened(browser, out / "index.html", complaints)
    page.click("summary:text('film')")
    page.evaluate("document.querySelector('video').play()")
    assert page.evaluate("document.querySelector('video').duration") > 1
    assert complaints == []
