"""A board: submissions side by side on a page that needs neither network nor server."""

import json
from base64 import b64encode
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any, cast

from jinja2 import Environment

from marl_mm.envs.registry import config_dict
from marl_mm.errors import UsageError
from marl_mm.eval.rows import write_csv
from marl_mm.eval.ties import tie_groups
from marl_mm.files import new_folder, refuse_existing, refuse_foreign, refuse_input
from marl_mm.progress import Bar, silent_bar
from marl_mm.runs.play import play
from marl_mm.runs.settings import as_path
from marl_mm.runs.submission import OF_A_SEED, Submission
from marl_mm.runs.submission_checks import read_submission
from marl_mm.runs.verification import VERIFIED, read_verification
from marl_mm.sim.config import Engine

PAGE = "index.html"

_TEMPLATE = Path(__file__).with_name("board.html")

_FILTERS = ("task", "dataset", "algorithm", "engine")

_VERDICTS = {
    "equal to the bit": ("verified", "good", "scored again: equal to the bit"),
    "equal within intervals": ("within intervals", "good", "equal within intervals"),
    "not equal": ("not equal", "bad", "scored again: not what was submitted"),
}
"""Words, class and explanation of each verdict."""

_UNVERIFIED = ("not verified", "open", "nobody has scored it again here")

_FORMULA = ("=", "+", "-", "@", "\t", "\r")
"""First characters of a text that a spreadsheet takes for a formula."""

_FILM_FPS = 5
"""Pictures per second of films."""


@dataclass(frozen=True)
class Entry:
    """A line of the board."""

    submission: Submission
    """The submission."""

    verification: Mapping[str, Any] | None
    """Record of its verification; None without one."""

    groups: tuple[int, ...]
    """Tie groups among entries of the same section, 1 for that of the best; none for an
    entry that is not what it claims."""

    @property
    def name(self) -> str:
        """Name of its files on the board."""
        return self.submission.fingerprint[:12]


@dataclass(frozen=True)
class Board:
    """A page with entries by task, data, engine and goals."""

    page: Path
    """The page."""

    sections: tuple[tuple[Entry, ...], ...]
    """Entries that can be compared, the best first."""

    def __repr__(self) -> str:
        return f"<Board {self.page}: {sum(map(len, self.sections))} submissions>"


def board(
    folders: Sequence[str | Path | Submission] | str | Path | Submission,
    *,
    out: str | Path = "board",
    films: bool = False,
    overwrite: bool = False,
    progress: Bar = silent_bar,
) -> Board:
    """Make a page of submissions: success, tie groups, verdicts, rows to download.

    Nothing is scored: verdicts are those that ``verify`` left beside the folders.

    Args:
        folders: Folders of submissions, or what ``submit`` returned. The verdicts that
            ``verify`` left beside them may be among them, as in ``FOLDER/*``.
        out: Folder of the page.
        films: Film an episode of each submission's first seed.
        overwrite: Replace an older board.
        progress: Factory of progress bars, see ``marl_mm.progress.Bar``.

    Raises:
        UsageError: If there is nothing to show, or twice the same.
        SubmissionError: If a submission has been changed.
    """
    if isinstance(folders, str | Path | Submission):
        folders = [folders]
    if not isinstance(folders, Iterable):
        raise UsageError(f"{folders!r:.80} is no submission, expected folders")
    found = [
        read_submission(each.folder if isinstance(each, Submission) else each)
        for each in folders
        if not str(each).endswith(VERIFIED)
    ]
    if not found:
        raise UsageError("no submission given, expected folders of marl-mm submit")
    target = as_path(out, "out")
    mark = PAGE, "<title>marl_mm: board<"
    refuse_foreign(target, overwrite, mark, (PAGE, "rows/*.csv", "films/*.mp4"))
    refuse_input(target, [submission.folder for submission in found])
    known: dict[str, Submission] = {}
    for submission in found:
        twin = known.setdefault(submission.fingerprint, submission)
        if twin is not submission:
            raise UsageError(f"{submission.folder} and {twin.folder} are the same")
    sections = _sections([*known.values()])
    with new_folder(target) as new:
        for entry in (entry for section in sections for entry in section):
            write_csv(new / f"rows/{entry.name}.csv", _rows(entry.submission))
            if films:
                _film(entry.submission, new / f"films/{entry.name}.mp4", progress)
        (new / PAGE).write_text(_page(sections, films), "utf-8")
        refuse_existing(target, overwrite)  # another process may have been faster
    return Board(target / PAGE, sections)


def _sections(submissions: Sequence[Submission]) -> tuple[tuple[Entry, ...], ...]:
    """Entries of the same task, data, engine and goals, the best first.

    Those whose verification says that they are not what they claim are last, and in no
    tie group.
    """
    sections: dict[str, list[Submission]] = {}
    for submission in submissions:
        manifest = submission.manifest
        dataset = manifest["dataset"] or {}
        data = dataset.get("recipe_sha256", dataset.get("fingerprint"))
        # The task as it is, however much of it is named.
        task = manifest["task"], config_dict(submission.task)
        parts = [dataset.get("id", ""), data, *task, manifest["engine"]]
        key = json.dumps([*parts, manifest["goals"]], sort_keys=True)
        sections.setdefault(key, []).append(submission)
    entries = []
    for section in sections.values():
        kept = [(read_verification(each), each) for each in section]
        kept.sort(key=lambda each: (_is_refuted(each[0]), -_success(each[1])))
        honest = [each for verdict, each in kept if not _is_refuted(verdict)]
        groups = tie_groups([each.scores("success") for each in honest])
        groups += [()] * (len(kept) - len(honest))
        entries.append(
            tuple(
                Entry(each, verdict, group)
                for (verdict, each), group in zip(kept, groups, strict=True)
            )
        )
    return tuple(sorted(entries, key=_place))


def _is_refuted(verification: Mapping[str, Any] | None) -> bool:
    return verification is not None and verification["verdict"] == "not equal"


def _success(submission: Submission) -> float:
    return float(submission.manifest["claims"]["success"])


def _place(section: Sequence[Entry]) -> tuple[str, str, int]:
    """Order of the sections: by task and data, those with most entries first."""
    manifest = section[0].submission.manifest
    return manifest["task"], (manifest["dataset"] or {}).get("id", ""), -len(section)


def _rows(submission: Submission) -> list[dict[str, Any]]:
    """Rows of all seeds for a table; what they are of stands first."""
    about = {name: submission.manifest[name] for name in ("algorithm", "task")}
    rows: list[dict[str, Any]] = []
    for run in submission.runs:
        head = about | {"run": run.config.seed}
        for episode in run.episodes:
            row = {**head, **episode.row, **head, "sha256": episode.sha256}
            rows.append({_cell(key): _cell(value) for key, value in row.items()})
    return rows


def _cell(value: Any) -> Any:
    """A value for a table: goals are texts, and no other text is a formula."""
    if isinstance(value, list):
        return " ".join(map(str, value))
    return f"'{value}" if isinstance(value, str) and value[:1] in _FORMULA else value


def _film(submission: Submission, path: Path, progress: Bar) -> None:
    run, manifest = submission.runs[0], submission.manifest
    film = play(
        run.folder,
        task=run.config.task,
        seed=manifest["goals"]["seed"],
        max_steps=manifest["overrides"].get("max_steps"),
        engine=cast(Engine, run.config.engine),
        fps=_FILM_FPS,
        progress=progress,
    )
    film.save(path)


def _page(sections: Sequence[Sequence[Entry]], films: bool) -> str:
    lines = [[_line(entry, films) for entry in section] for section in sections]
    every = [line for section in lines for line in section]
    environment = Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True)
    source = _TEMPLATE.read_text("utf-8")
    script = source.partition("<script>")[2].partition("</script>")[0]
    return environment.from_string(source).render(
        sections=lines,
        filters={name: sorted({line[name] for line in every}) for name in _FILTERS},
        script=b64encode(sha256(script.encode()).digest()).decode(),
        count=len(every),
    )


def _settings(submission: Submission) -> list[tuple[str, str]]:
    """Hyper-parameters and other settings of all seeds, by name."""
    settings = submission.runs[0].config.settings.items()
    return [
        (f"{k:.60}", f"{v!s:.60}")
        for k, v in settings
        if k not in (*OF_A_SEED, "max_steps")
    ]


def _line(entry: Entry, films: bool) -> Mapping[str, Any]:
    """What the page shows of an entry."""
    manifest, claims = entry.submission.manifest, entry.submission.manifest["claims"]
    record = entry.verification or {"verdict": "", "scored": 0, "episodes": 0}
    words, kind, about = _VERDICTS.get(record["verdict"], _UNVERIFIED)
    if (count := record["scored"]) < (every := record["episodes"]):
        words += f", {count} of {every}"
        if kind == "good" and 2 * count < every:  # most of what is false was not seen
            kind = "open"
    if entry.verification is not None:
        about += f"; success {100 * record['success']:.1f} %"
    steps = manifest["overrides"].get("max_steps")
    return {
        **{name: manifest[name] for name in ("algorithm", "task", "engine", "goals")},
        "dataset": (manifest["dataset"] or {}).get("id", "own episodes"),
        "steps": "" if steps is None else f"{steps} steps",
        "groups": entry.groups,
        "seeds": [f"{100 * rate:.1f}" for rate in claims["success_seeds"]],
        "success": 100 * claims["success"],
        "interval": [100 * bound for bound in claims["success_interval"]],
        "return": claims["return"],
        "return_interval": claims["return_interval"],
        "verdict": (words, kind, about),
        "machine": f"{manifest['machine'].get('processor', ''):.60}",
        "settings": _settings(entry.submission),
        "name": entry.name,
        "rows": f"rows/{entry.name}.csv",
        "film": f"films/{entry.name}.mp4" if films else "",
    }
