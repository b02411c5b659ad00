"""All results on one page of HTML, which needs nothing else: no network, no files."""

from base64 import b64encode
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from mimetypes import guess_type
from pathlib import Path

from jinja2 import Environment
from markupsafe import Markup

from marl_mm.errors import MarlMmError, UsageError
from marl_mm.eval.bench.tables import (
    abuse_table,
    bench_table,
    data_table,
    env_table,
    gpu_table,
    offline_speed_table,
    tick_table,
    vector_table,
)
from marl_mm.eval.rows import read_rows
from marl_mm.eval.studies.alpha import STEPS
from marl_mm.eval.studies.paper import NOTE
from marl_mm.eval.studies.table import Table
from marl_mm.eval.studies.targets import COMPARISONS, STUDIES
from marl_mm.eval.tables import literal_table, markdown_html, markdown_table
from marl_mm.received import (
    check_regular,
    damage_named,
    read_json,
    read_text,
    refuse_links_out,
)
from marl_mm.versions import versions

_TEMPLATE = Path(__file__).with_name("report.html")


@dataclass(frozen=True)
class Media:
    """A picture or a video within the page."""

    name: str
    """Name of the file."""

    kind: str
    """MIME type."""

    data: str
    """Data URL with the whole file."""


@dataclass(frozen=True)
class Section:
    """A part of the page."""

    name: str
    """Anchor of the section."""

    title: str
    """Heading."""

    command: str = ""
    """Command that makes it."""

    text: str | Markup = ""
    """Text below the heading."""

    media: Sequence[Media] = ()
    """Pictures and videos."""

    details: Sequence[tuple[str, str]] = ()
    """Titles and texts of folded parts."""


def report_page(results: Path, videos: Sequence[Path] = ()) -> str:
    """The page.

    Args:
        results: Folder with any of ``studies``, ``alpha``, ``controller``,
            ``data``, ``env`` and ``offline``; or of runs, with results in ``studies``.
        videos: Files of films to show.

    Raises:
        UsageError: If there is nothing to show, or a video is none.
        MarlMmError: If a file is damaged, or a link out of the folder.
    """
    studies = results / "studies"
    if (studies / "results").is_dir():  # of a folder of runs
        studies = studies / "results"
    with damage_named(str(results), MarlMmError):
        sections = [
            *_studies(results, studies),
            *_sweep(results),
            *_benchmarks(results),
            *_videos(videos),
        ]
    if not sections:
        raise UsageError(
            f"{results} has no results, expected a folder such as eval/results that "
            "marl-mm ablate --out FOLDER/studies has filled"
        )
    packages = list(versions("matplotlib").items())
    text = _html(markdown_table(("package", "version"), packages))
    made = Section("versions", "Versions that drew this page", text=text)
    environment = Environment(autoescape=True, trim_blocks=True)
    page = environment.from_string(_TEMPLATE.read_text("utf-8"))
    return page.render(
        title="marl_mm: results",
        about="Tables and figures, what they were made of, and the commands that make "
        "them. Success rates: mean and standard deviation over seeds, and the wider of "
        "two 95 % intervals, Student's over seeds and Wilson's over goals.",
        sections=[*sections, made],
    )


def _within(results: Path, files: Iterable[Path]) -> list[Path]:
    """The files that exist, sorted. Whoever gets the page gets their bytes.

    Raises:
        MarlMmError: If one is a link out of the folder of results.
    """
    there = sorted(path for path in files if path.exists())
    names = [str(path.relative_to(results)) for path in there]
    refuse_links_out(results, names, MarlMmError)
    return there


def _studies(results: Path, folder: Path) -> Iterator[Section]:
    """Our studies as tables, in our order; other studies and parts as rows."""
    figures = {path.stem: path for path in _within(results, folder.glob("*.png"))}
    tables = {path.name: path for path in _within(results, folder.glob("*.csv"))}

    def drawn(name: str, title: str, target: str, text: str) -> Section:
        media = [_media(figures[name])] if name in figures else []
        command = f"marl-mm ablate {target} --out {folder} --overwrite"
        return Section(name, title, command, _html(text), media)

    for name, study in STUDIES.items():
        if path := tables.pop(f"{name}.csv", None):
            table = Table(study, read_rows(path))
            yield drawn(name, study.about, name, f"{table.markdown()}\n{NOTE}")
    for name, comparison in COMPARISONS.items():
        if path := tables.pop(comparison.file, None):
            text = comparison.markdown(read_rows(path))
            yield drawn(name, comparison.about, name, text)
    tables.pop(STEPS, None)
    for path in tables.values():
        text = literal_table(read_rows(path))
        yield drawn(path.stem, path.stem, "TARGET", text)
    if made_of := _within(results, folder.glob("rows/*/*.json")):
        details = [
            (f"{p.parent.name}, {p.stem}", read_text(p, UsageError)) for p in made_of
        ]
        yield Section("configs", "What the runs were made of", details=details)


def _sweep(results: Path) -> Iterator[Section]:
    folder = results / "alpha"
    if (folder / "alpha.csv").exists():
        tables = map(read_rows, _within(results, folder.glob("*.csv")))
        text = _html("\n".join(map(literal_table, tables)))
        media = [_media(path) for path in _within(results, folder.glob("*.png"))]
        command = f"marl-mm sweep-alpha --out {folder} --overwrite"
        yield Section("sweep", "What alpha does", command, text, media)


def _benchmarks(results: Path) -> Iterator[Section]:
    tables = {
        "controller/bench.json": ("The controller's time", "control", bench_table),
        "data/bench.json": ("Collecting and loading", "data", data_table),
        "offline/bench.json": ("Offline updates", "train", offline_speed_table),
        "offline/gpu.json": ("Updates on a GPU", "train --gpu", gpu_table),
    }
    for name, (title, target, table) in tables.items():
        for path in _within(results, [results / name]):
            text = _html(table(read_json(path, UsageError)))
            key = name.replace("/", "-")
            yield Section(key, title, f"marl-mm bench {target}", text)
    engines = _within(results, results.glob("env/*.json"))
    if times := {path.stem: read_json(path, UsageError) for path in engines}:
        parts = [table(times) for table in (env_table, tick_table, vector_table)]
        text = _html("\n".join(parts))
        yield Section("env", "Environment steps", "marl-mm bench env", text)
    abuse = _within(results, results.glob("controller/abuse-*.json"))
    if reports := {p.stem[len("abuse-") :]: read_json(p, UsageError) for p in abuse}:
        text = _html(abuse_table(reports))
        command = "marl-mm bench abuse --ticks 1000000"
        yield Section("abuse", "Limits under abuse", command, text)


def _videos(videos: Sequence[Path]) -> Iterator[Section]:
    if media := [_media(path) for path in videos]:
        yield Section("videos", "Videos", "marl-mm play RUN --video FILE", media=media)


def _media(path: Path) -> Media:
    kind, _ = guess_type(path)
    if kind is None or not kind.startswith(("image", "video")):
        raise UsageError(f"{path} is neither a picture nor a video by its name")
    check_regular(path, UsageError)
    data = b64encode(path.read_bytes()).decode()
    return Media(path.name, kind, f"data:{kind};base64,{data}")


def _html(text: str) -> Markup:
    """Markdown with tables; HTML and links in it are shown as text."""
    page = markdown_html(text).replace("<table>", '<div class="table"><table>')
    return Markup(page.replace("</table>", "</table></div>"))
