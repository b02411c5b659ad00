"""Cards of datasets: their contents as numbers, as text and as a figure.

A card is stored with its dataset as ``card.json``, ``card.md`` and ``card.png``.
"""

import io
import json
import shutil
import textwrap
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from marl_mm.datasets.arrays import EpisodeArrays
from marl_mm.errors import DatasetError
from marl_mm.files import new_file, write_json
from marl_mm.markdown import literal, one_line
from marl_mm.notebook import html_picture, html_table
from marl_mm.received import read_json

if TYPE_CHECKING:
    from marl_mm.datasets.dataset import Dataset

_BINS = 10
_CELL = 0.1
"""Edge of the cells that coverage counts [m]."""

SUMS = "SHA256SUMS"
"""File with the sums of an exported folder's files."""

LATER = {"made_of", "data_sha256", "engine"}
"""Keys that cards of version 1 lack, or some of them."""

_HAND = ("end_effector_x", "end_effector_y", "end_effector_z")
_BASE = ("base_x", "base_y")


def card(dataset: "Dataset") -> dict[str, Any]:
    """Size, successes, lengths, returns, alphas, coverage and sources of a dataset.

    The values are JSON-serialisable; lengths are in steps. A histogram has ten bins of
    equal width from ``low`` to ``high``.
    """
    arrays = dataset.arrays
    record = dataset.metadata["marl_mm"]
    ahead, successes = arrays.ahead(), arrays.successes()
    ways = {"all": slice(None)} if ahead is None else _ways(ahead)
    return {
        "id": dataset.metadata["dataset_id"],
        "path": str(dataset.location.folder),
        "task": record["task"],
        "engine": dataset.provenance.engine_text,
        "collector": record.get("collector"),
        "seed": record.get("seed"),
        "complete": record.get("complete"),
        "recipe": record.get("recipe"),
        "made_of": _made_of(record),
        "data_sha256": record.get("data_sha256"),
        "attempts": record.get("attempts"),
        "rejected": _rejected(record),
        "steps": arrays.steps,
        "episodes": len(arrays),
        "success": {name: _share(successes[chosen]) for name, chosen in ways.items()},
        "episode_length": _spread(arrays.lengths),
        "episode_return": _spread(arrays.returns()),
        "return_histogram": _histogram(arrays.returns()),
        **_alphas(arrays),
        "coverage": coverage(arrays),
        "sources": _sources(arrays),
    }


def _made_of(record: dict[str, Any]) -> dict[str, Any] | None:
    """What a collection is repeated by; None of other datasets."""
    if record.get("steps_asked") is None or record.get("recipe") is not None:
        return None
    names = ("task", "overrides", "collector", "collector_config", "seed", "packages")
    return {
        **{name: record.get(name) or {} for name in names if name != "seed"},
        "seed": record.get("seed"),
        "steps": record["steps_asked"],
        **{name: record[name] for name in ("weights", "plugins") if record.get(name)},
    }


def coverage(arrays: EpisodeArrays) -> dict[str, float]:
    """Variety of the data: the numbers of cells that states and actions fall into.

    A state's cell has cubes of 10 cm for the vector from the compared entries to the
    goal and, where the layout has them, for the vector from the base to the hand. The
    cell of a state and an action has thirds of each action's range, too. After
    Schweighofer 2022, who count unique pairs.
    """
    states = arrays.states[~arrays.is_last_state()]
    layout = arrays.layout
    seen = states[:, layout.goal] - states[:, layout.achieved]
    if {*_HAND, *_BASE} <= set(layout.state_names):
        base = np.zeros((len(states), 3))
        base[:, :2] = states[:, layout.columns(*_BASE)]
        seen = np.hstack([seen, states[:, layout.columns(*_HAND)] - base])
    low, high = np.array(layout.low), np.array(layout.high)
    thirds = np.minimum((arrays.actions - low) / (high - low) * 3, 2).astype(int)
    cells = np.floor(seen / _CELL).astype(int)
    pairs = len(np.unique(np.hstack([cells, thirds]), axis=0))
    return {
        "state_cells": len(np.unique(cells, axis=0)),
        "state_action_cells": pairs,
        "state_action_cells_per_step": pairs / arrays.steps,
    }


def keep_card(dataset: "Dataset") -> dict[str, Any]:
    """Write a dataset's card into its folder as JSON, Markdown and figure; return it.

    Without room or permission, and to a folder with sums of its files, nothing is
    written.
    """
    values = card(dataset)
    kept = _without_path(values)
    folder = dataset.location.folder
    if (folder / SUMS).exists():  # of an export
        return values
    path = folder / "card.json"
    if all((folder / f"card.{kind}").exists() for kind in ("json", "md", "png")):
        with suppress(DatasetError):
            if read_json(path, DatasetError) == kept:
                return values
    try:
        write_card(dataset, values, folder / "card")
        write_json(path, kept)  # last: with it the others are taken to be its own
    except OSError:  # somebody else's folder, or a full disk
        pass
    return values


def kept_card(dataset: "Dataset") -> dict[str, Any]:
    """The card as it is kept with a dataset, wherever that is."""
    kept: dict[str, Any] = json.loads(json.dumps(_without_path(card(dataset))))
    return kept


def _without_path(values: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in values.items() if key != "path"}


def write_card(dataset: "Dataset", values: dict[str, Any], stem: Path) -> None:
    """Write a card as Markdown and figure; ``stem`` is their path without ending."""
    from marl_mm.datasets.card_figure import draw_card  # matplotlib takes a second

    kept = _without_path(values)
    page, figure = (stem.with_name(stem.name + end) for end in (".md", ".png"))
    with new_file(page) as temporary:
        temporary.write_text(card_markdown(kept, figure.name), "utf-8")
    with new_file(figure) as temporary:
        draw_card(dataset.arrays, kept, temporary)


def card_text(values: dict[str, Any]) -> str:
    """The card as lines of text, as wide as the terminal; into a pipe, one a value."""
    rows = _rows(values)
    width = max(len(name) for name, _ in rows) + 2
    lines = textwrap.TextWrapper(
        shutil.get_terminal_size((100_000, 24)).columns,
        subsequent_indent=" " * width,
        break_long_words=False,
        break_on_hyphens=False,
    )
    return "\n".join(lines.fill(f"{name:<{width}}{text}") for name, text in rows)


def card_markdown(values: dict[str, Any], figure: str = "card.png") -> str:
    """The card as a Markdown page that shows the figure, a file beside it."""
    rows = "\n".join(f"| {name} | {literal(text)} |" for name, text in _rows(values))
    return f"# {values['id']}\n\n| | |\n| --- | --- |\n{rows}\n\n![card]({figure})\n"


def card_html(dataset: "Dataset") -> str:
    """The card as a table with its figure, for notebooks."""
    from marl_mm.datasets.card_figure import draw_card  # matplotlib takes a second

    values, picture = card(dataset), io.BytesIO()
    draw_card(dataset.arrays, values, picture)
    return html_table(_rows(values)) + html_picture(picture.getvalue(), "card")


def _rows(values: dict[str, Any]) -> list[tuple[str, str]]:
    texts = {
        key: _histogram_text(value) if key.endswith("_histogram") else _text(value)
        for key, value in values.items()
        if value is not None
    }
    texts["success"] = ", ".join(
        f"{direction} {_percent(value['rate'])} of {value['episodes']}"
        for direction, value in values["success"].items()
        if value["episodes"]
    )
    seen = values["coverage"]
    texts["coverage"] = (
        f"{seen['state_cells']} cells of {100 * _CELL:.0f} cm of compared entries to "
        f"goal and, where there are such, base to hand; {seen['state_action_cells']} "
        "with the action by thirds"
    )
    texts["sources"] = "; ".join(
        f"{row['steps']} steps ({_percent(row['share'])}) of {row['dataset']} by "
        f"{row['collector']}"
        for row in values["sources"]
    )
    return [(key.replace("_", " "), one_line(text)) for key, text in texts.items()]


def _histogram_text(value: dict[str, Any]) -> str:
    low, high = _text(value["low"]), _text(value["high"])
    return f"{bars(value['counts'])}  {low} to {high}"


def _text(value: Any) -> str:
    if isinstance(value, dict):
        inner = {
            key: f" ({_text(item)})" if isinstance(item, dict) else f": {_text(item)}"
            for key, item in value.items()
        }
        return ", ".join(key + text for key, text in inner.items())
    if isinstance(value, list):
        return "; ".join(_text(item) for item in value)
    if isinstance(value, float):
        return f"{value:.3g}"
    return "-" if value is None else str(value)


def _percent(rate: float | None) -> str:
    return "-" if rate is None else f"{100 * rate:.0f} %"


def bars(counts: list[int]) -> str:
    """A histogram as one line of text."""
    top = max(max(counts), 1)
    return "".join(" ▁▂▃▄▅▆▇█"[-(-8 * count // top)] for count in counts)


def _rejected(record: dict[str, Any]) -> int | None:
    """Number of episodes that were run and not kept; None of mixes."""
    attempts = record.get("attempts")
    return None if attempts is None else attempts - int(record["episodes"])


def _share(successes: np.ndarray) -> dict[str, Any]:
    rate = float(np.mean(successes)) if len(successes) else None
    return {"episodes": len(successes), "rate": rate}


def _ways(ahead: np.ndarray) -> dict[str, np.ndarray]:
    return {"forward": ahead, "backward": ~ahead}


def _alphas(arrays: EpisodeArrays) -> dict[str, Any]:
    """Spread and histogram of alpha, if the layout has it."""
    if "alpha" not in arrays.layout.action_names:
        return {}
    alphas = arrays.actions[:, arrays.layout.action_names.index("alpha")].astype(float)
    return {
        "alpha": _spread(alphas),
        "alpha_histogram": _histogram(alphas, (0.0, 1.0)),
    }


def _spread(values: np.ndarray) -> dict[str, float]:
    return {
        "min": float(np.min(values)),
        "mean": float(np.mean(values)),
        "max": float(np.max(values)),
    }


def _histogram(
    values: np.ndarray, ends: tuple[float, float] | None = None
) -> dict[str, Any]:
    if ends is None and np.isclose(values.min(), values.max()):  # but for last bits
        values = np.full(len(values), values[0])
    counts, edges = np.histogram(values, bins=_BINS, range=ends)
    return {
        "low": float(edges[0]),
        "high": float(edges[-1]),
        "counts": counts.tolist(),
    }


def _sources(arrays: EpisodeArrays) -> list[dict[str, Any]]:
    """Steps of each dataset and policy that the episodes come from."""
    rows = []
    for origin in np.unique(arrays.origins):
        of_origin = arrays.origins == origin
        for source in np.unique(arrays.sources[of_origin]):
            chosen = of_origin & (arrays.sources == source)
            steps = int(arrays.lengths[chosen].sum())
            rows.append(
                {
                    "dataset": str(origin),
                    "collector": str(source),
                    "episodes": int(chosen.sum()),
                    "steps": steps,
                    "share": steps / arrays.steps,
                }
            )
    return rows
