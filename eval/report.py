"""All results on one page of HTML, which needs nothing else: no network, no files."""

import json
from base64 import b64encode
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from mimetypes import guess_type
from pathlib import Path
from typing import Any

from jinja2 import Environment
from markdown_it import MarkdownIt
from markupsafe import Markup

from marl_mm.errors import UsageError
from marl_mm.eval.ablation import cell_name
from marl_mm.eval.ablations import ABLATIONS, NOTE
from marl_mm.eval.bench.tables import (
    abuse_table,
    bench_table,
    data_table,
    offline_speed_table,
)
from marl_mm.eval.offline import ablation_table, goals_table
from marl_mm.eval.online import MADE_OF, SETTINGS, OnlineSetting
from marl_mm.eval.online_tables import (
    alpha_worth_table,
    online_text,
    steps_table,
    updates_table,
)
from marl_mm.eval.rows import read_rows
from marl_mm.eval.sweep import responses
from marl_mm.eval.sweep_tables import sweep_markdown
from marl_mm.eval.tables import rows_table
from marl_mm.versions import versions

_TEMPLATE = Path(__file__).with_name("report.html")

_FIGURES = ("fig4.png", "fig5.png", "fig6.png", "demonstrations.png", "alpha.png")
"""Of online learning, by the names of the targets that draw them."""

_TABLES = {
    "curves.csv.gz": ("online", "goals reached by steps", steps_table),
    "alpha_worth.csv": (
        "alpha",
        "learnt alpha against the best held",
        alpha_worth_table,
    ),
}
"""Other tables of online learning: what they are made of, and by which target."""


@dataclass(frozen=True)
class Media:
    """A picture or a video within the page."""

    name: str
    kind: str
    """Its MIME type."""

    data: str
    """As an address that holds it all."""


@dataclass(frozen=True)
class Section:
    """A part of the page."""

    name: str
    title: str
    command: str = ""
    """What makes it."""

    text: str | Markup = ""
    media: Sequence[Media] = ()
    details: Sequence[tuple[str, str]] = ()
    """Titles and texts that are folded."""


def report_page(results: Path, videos: Sequence[Path] = ()) -> str:
    """The page.

    Args:
        results: Folder with what there is of ``offline``, ``online``, ``alpha``,
            ``controller`` and ``data``; or of runs, with results in ``offline`` and
            ``online``.
        videos: Shown, too.

    Raises:
        UsageError: If there is nothing to show, or a video is none.
    """
    sections = [
        *_offline(_drawn(results / "offline")),
        *_online(_drawn(results / "online")),
        *_alpha(results / "alpha"),
        *_benchmarks(results),
        *_videos(videos),
    ]
    if not sections:
        raise UsageError(
            f"{results} has no results, expected a folder such as eval/results that "
            "marl-mm ablate --out FOLDER/offline has filled"
        )
    made = Section(
        "versions", "Versions that drew this page", text=_table(versions("matplotlib"))
    )
    environment = Environment(autoescape=True, trim_blocks=True)
    page = environment.from_string(_TEMPLATE.read_text())
    return page.render(
        title="marl_mm: results",
        about="Tables and figures, what they were made of, and the commands that make "
        "them. Success rates: mean and standard deviation over seeds, and the wider of "
        "two 95 % intervals, Student's over seeds and Wilson's over goals.",
        sections=[*sections, made],
    )


def _drawn(folder: Path) -> Path:
    """Where tables are: in a folder of runs, they are in a folder of their own."""
    return folder / "results" if (folder / "results").is_dir() else folder


def _offline(folder: Path) -> Iterator[Section]:
    paths = {path.stem: path for path in sorted(folder.glob("*.csv"))}
    order = [name for name in ABLATIONS if name in paths]
    for name in (*order, *(name for name in paths if name not in ABLATIONS)):
        rows = read_rows(paths[name])
        whole = name.removesuffix("-part")  # of some --datasets or --settings
        if whole in ABLATIONS:
            own = {(row["dataset"], row["setting"]) for row in rows}
            cells = [c for c in ABLATIONS[whole].cells if cell_name(c) in own]
            ablation = replace(ABLATIONS[whole], cells=cells)
            title, text = ablation.about, f"{ablation_table(ablation, rows)}\n{NOTE}"
        else:
            title, text = name, rows_table(rows)
        figure = folder / f"{name}.png"
        media = [_media(figure)] if figure.exists() else []
        target = whole if whole in ABLATIONS else "FILE.py:NAME"
        if whole in ABLATIONS and whole != name:
            target = f"{whole} --datasets ... --settings ..."
        command = f"marl-mm ablate {target} --out {folder} --overwrite"
        yield Section(name, title, command, _html(text), media)
    if paths:
        text = _html(goals_table())
        command = "python tools/pages.py"
        yield Section("goals", "Goals for an interval of +- 5 points", command, text)
    made_of = sorted(folder.glob("rows/*/*.json"))
    if made_of:
        details = [
            (f"{path.parent.name}, {path.stem}", path.read_text()) for path in made_of
        ]
        yield Section("configs", "What the runs were made of", details=details)


def _online(folder: Path) -> Iterator[Section]:
    curves = folder / "curves.csv.gz"
    for stem in ("online", "online-part"):
        if (folder / f"{stem}.csv").exists():
            summary = read_rows(folder / f"{stem}.csv")
            text = _html(online_text(summary, SETTINGS, read_rows(curves)))
            yield Section(stem, "Online learning", _redrawn("online", folder), text)
    for name, (target, about, table) in _TABLES.items():
        if (folder / name).exists():
            text = _html(table(read_rows(folder / name), SETTINGS))
            command = _redrawn(target, folder)
            yield Section(f"online-{name}", f"Online: {about}", command, text)
    for name in _FIGURES:
        if (folder / name).exists():
            media = [_media(folder / name)]
            target = name.removesuffix(".png")
            title, command = f"Online: {target}", _redrawn(target, folder)
            yield Section(f"online-{name}", title, command, media=media)
    if (folder / "online.csv").exists():
        path = folder / MADE_OF
        made_of = json.loads(path.read_text()) if path.exists() else {}
        details = [
            (f"{name}, {config['task']}", json.dumps(config, indent=2))
            for name, config in made_of.items()
        ]
        details += [_declared(one) for one in SETTINGS if one.name not in made_of]
        yield Section("online-configs", "Configs of online runs", details=details)


def _declared(setting: OnlineSetting) -> tuple[str, str]:
    """What a setting is to be made of, where it was not kept what its runs were."""
    name = f"{setting.name}, {setting.task}, as declared"
    return name, json.dumps(asdict(setting.config), indent=2)


def _redrawn(target: str, folder: Path) -> str:
    """What draws something of online learning again, from its rows."""
    return f"marl-mm ablate {target} --rows {folder} --out {folder} --overwrite"


def _alpha(folder: Path) -> Iterator[Section]:
    if (folder / "alpha.csv").exists():
        summary, worth, loads = (
            read_rows(folder / f"{name}.csv")
            if (folder / f"{name}.csv").exists()
            else []
            for name in ("alpha", "worth", "loads")
        )
        text = _html(sweep_markdown(summary, responses(summary), worth, loads))
        media = [_media(path) for path in sorted(folder.glob("*.png"))]
        command = f"marl-mm sweep-alpha --out {folder} --overwrite"
        yield Section("alpha", "What alpha does", command, text, media)


def _benchmarks(results: Path) -> Iterator[Section]:
    tables = {
        "controller/bench.json": ("The controller's time", "control", bench_table),
        "data/bench.json": ("Collecting and loading", "data", data_table),
        "offline/bench.json": ("Offline updates", "train", offline_speed_table),
        "online/bench.json": ("Online updates", "train", _online_updates),
    }
    for name, (title, target, table) in tables.items():
        if (results / name).exists():
            text = _html(table(json.loads((results / name).read_text())))
            key = name.replace("/", "-")
            yield Section(key, title, f"marl-mm bench {target}", text)
    paths = {
        form: results / f"controller/abuse-{form}.json" for form in ("blend", "rhp")
    }
    found = {f: json.loads(p.read_text()) for f, p in paths.items() if p.exists()}
    if found:
        text = _html(abuse_table(found))
        command = "marl-mm bench abuse --ticks 1000000"
        yield Section("abuse", "Limits under abuse", command, text)


def _online_updates(result: dict[str, Any]) -> str:
    return updates_table(result, SETTINGS)


def _videos(videos: Sequence[Path]) -> Iterator[Section]:
    media = [_media(path) for path in videos]
    if media:
        yield Section("videos", "Videos", "marl-mm play RUN --video FILE", media=media)


def _media(path: Path) -> Media:
    kind, _ = guess_type(path)
    if kind is None or not kind.startswith(("image", "video")):
        raise UsageError(f"{path} is neither a picture nor a video by its name")
    try:
        data = b64encode(path.read_bytes()).decode()
    except FileNotFoundError:
        raise UsageError(f"there is no {path}") from None
    return Media(path.name, kind, f"data:{kind};base64,{data}")


def _html(text: str) -> Markup:
    """Markdown with tables; HTML in it is shown as text."""
    page = MarkdownIt("commonmark", {"html": False}).enable("table").render(text)
    page = page.replace("<table>", '<div class="table"><table>')
    return Markup(page.replace("</table>", "</table></div>"))


def _table(values: dict[str, str]) -> Markup:
    lines = "\n".join(f"| {name} | {value} |" for name, value in values.items())
    return _html(f"| package | version |\n| --- | --- |\n{lines}\n")
