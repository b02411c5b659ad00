"""Reference pages of algorithms and datasets, made of registries and results."""

import ast
import inspect
from collections.abc import Callable
from dataclasses import fields, is_dataclass
from functools import partial

from committed_rows import (
    NAMES,
    ROOT,
    baseline_rows,
    benchmark_mean,
    benchmark_rows,
    engine_named,
    fine_tuning_rows,
    offline_rows,
    online_rows,
    task_of,
)
from drawings import CURVES
from who_sees import kind

from marl_mm.algorithms.registry import (
    ALGORITHMS,
    BENCHMARK,
    PAPER,
    TUNED,
    Algorithm,
    Imported,
)
from marl_mm.datasets.card import card_markdown
from marl_mm.datasets.dataset import load_dataset
from marl_mm.eval.studies.baselines import DATASETS, LEARNERS
from marl_mm.eval.tables import markdown_table, rate_with_interval

# --- Algorithms --------------------------------------------------------------


def _algorithm_page(name: str) -> str:
    algorithm = ALGORITHMS.get(name)
    assert isinstance(algorithm.learner, Imported)
    file = f"algorithms/{algorithm.learner.file}"
    text = ast.get_docstring(ast.parse((ROOT / file).read_text("utf-8")))
    assert text is not None
    first, _, rest = text.partition("\n\n")
    data = "" if algorithm.online else " --dataset good-5k"
    if getattr(algorithm.presets[TUNED], "updates", 1) == 0:
        data += " --online-steps 5000"
    curve = ""
    if name in CURVES:
        where = "`Reach-v0`" if algorithm.online else "good-30k"
        curve = (
            f"![Goals reached while {name} learns](../../images/curve-{name}.svg)\n\n"
            f"Goals reached on {where} while it learns, mean and three seeds.\n\n"
        )
    if any(setting.algorithm == name for setting in LEARNERS):
        curve += (
            f"![Goals reached while {name} learns](../../images/baseline-{name}.svg)\n\n"
            f"Goals reached on {' and '.join(DATASETS)}, which ship, while it learns with "
            "its preset, 5,000 updates: one seed, 20 goals a point.\n"
        )
    ours = algorithm.source == "ours"
    parts = [
        f"# {NAMES[name]}\n",
        f"**{algorithm.about}** Source: {algorithm.source}. {_headline(name)}\n",
        algorithm.advice and f"**When to use it.** {algorithm.advice}\n",
        f"```sh\nmarl-mm train {name}{data} --seeds 0 1 2\n```\n",
        "## Loss\n",
        f"Of the actors:\n\n```text\n{algorithm.loss}\n```\n",
        f"[{file}](../../../{file}){'' if ours else ', in the order of its source'}:\n",
        f"```text\n{first}\n\n{rest}\n```\n",
        "## Who sees what\n",
        f"![Who sees what in training and in acting](../../{kind(name).picture})\n",
        "Of the paper's two agents, as of any others; algorithms that are made of the "
        "same networks have the same picture.\n",
        *(
            []
            if ours
            else [
                "## What departs from the source\n",
                algorithm.departs and f"{algorithm.departs}\n",
                _departures(name),
            ]
        ),
        "## Results\n",
        curve,
        _algorithm_results(name),
        "## Hyper-parameters\n",
        _hyper_parameters(algorithm),
    ]
    return "\n".join(part for part in parts if part)


def _headline(name: str) -> str:
    if ALGORITHMS.get(name).online:
        rows = [row for row in online_rows() if row["setting"] == name]
        if not rows:
            return "No results of it are committed."
        (row,) = rows
        return (
            f"On `Reach-v0` it reaches {100 * row['success_last']:.1f} % of goals in the "
            f"end, and 70 % of them after {row['to_70']:.0f} episodes."
        )
    if rows := [row for row in offline_rows() if row["setting"] == name]:
        good = next(row for row in rows if row["dataset"] == "good-30k")
        first = f"From good-30k it reaches {100 * good['success']:.1f} % of goals. "
        return first + _benchmark_headline(name)
    if benchmark_rows(name):
        return _benchmark_headline(name)
    for how, rows in (
        ("After own episodes beside the data", fine_tuning_rows(name)),
        ("With its preset, 5,000 updates and one seed", baseline_rows(name)),
    ):
        if rows:
            *most, last = (
                f"{100 * row['success']:.0f} % from `{row['dataset']}`" for row in rows
            )
            reached = f"{', '.join(most)} and {last}" if most else last
            return f"{how} it reaches {reached.replace('%', '% of goals', 1)}."
    return "No results of it are committed."


def _benchmark_headline(name: str) -> str:
    """Where an algorithm reaches least and most of the benchmark, and its mean."""
    rows = sorted(benchmark_rows(name), key=lambda row: float(row["success"]))
    worst, best = (
        f"{100 * row['success']:.0f} % from `{row['dataset']}`"
        for row in (rows[0], rows[-1])
    )
    mean = benchmark_mean(name)
    return (
        f"In the [benchmark](../../results/benchmark.md) it reaches {worst} to {best}, "
        f"{100 * mean['iqm']:.0f} % in the interquartile mean over {mean['datasets']} "
        f"datasets; on {mean['first']} of them it cannot be told from the best."
    ).replace("%", "% of goals", 1)


WORTH = {
    False: "../../results/offline.md#why-the-papers-settings-fail-and-what-cures-them",
    True: "../../results/online.md#success-and-episodes-needed",
}
"""Where it stands what departures of learners with critics are worth, by online."""


def _departures(name: str) -> str:
    """Numbers that are not the paper's."""
    algorithm = ALGORITHMS.get(name)
    if PAPER not in algorithm.presets:
        return "Which numbers are the source's is said below; the others are ours.\n"
    tuned, paper = algorithm.presets[TUNED], algorithm.presets[PAPER]
    documented = field_texts(type(tuned))
    rows = []
    for item in fields(tuned):
        ours, theirs = (str(getattr(preset, item.name)) for preset in (tuned, paper))
        if ours != theirs:
            rows.append((f"`{item.name}`", ours, theirs, documented[item.name]))
    header = ("field", "`tuned`, the default", "`paper`", "meaning")
    worth = f" [What they are worth]({WORTH[algorithm.online]})." * (len(rows) > 1)
    return (
        "`--preset paper` takes the paper's numbers, and where it is silent its "
        f"sources' choices.{worth}\n\n{markdown_table(header, rows)}"
    )


def _hyper_parameters(algorithm: Algorithm) -> str:
    config = algorithm.presets[TUNED]
    documented = field_texts(type(config))
    columns = {"default": config}
    if BENCHMARK in algorithm.presets:
        columns["`benchmark`"] = algorithm.presets[BENCHMARK]
    rows = []
    for item in fields(config):
        default, *others = (str(getattr(each, item.name)) for each in columns.values())
        others = ["" if other == default else other for other in others]
        rows.append((f"`{item.name}`", default, *others, documented[item.name]))
    return markdown_table(("field", *columns, "meaning"), rows)


def field_texts(kind: type) -> dict[str, str]:
    """Docstrings that stand under the fields of a dataclass and of its bases."""
    texts: dict[str, str] = {}
    for base in reversed(kind.__mro__):
        if not is_dataclass(base):
            continue
        (tree,) = ast.parse(inspect.getsource(base)).body
        assert isinstance(tree, ast.ClassDef)
        name = ""
        for node in tree.body:
            if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
                name = node.target.id
            elif isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
                if name:
                    texts[name] = " ".join(str(node.value.value).split())
                name = ""
    return {name: text.replace("|", "\\|") for name, text in texts.items()}


def _algorithm_results(name: str) -> str:
    if ALGORITHMS.get(name).online:
        rows = [
            (
                row["about"],
                row["task"],
                rate_with_interval(row, "success_last"),
                f"{row['to_70']:.0f}" if row["to_70"] == row["to_70"] else "-",
                f"{row['return_last']:.2f}",
                engine_named(row),
            )
            for row in online_rows()
            if row["algorithm"] == name
        ]
        if not rows:
            return "None are committed: `marl-mm train` makes yours.\n"
        header = "setting", "task", "goals reached [%]", "episodes to 70 %", "return"
        return (
            markdown_table((*header, "engine"), rows)
            + "\n[Online learning](../../results/online.md).\n"
        )
    preset = [row for row in offline_rows() if row["setting"] == name]
    sources = {
        "preset, [offline learning](../../results/offline.md)": preset,
        "preset, [baselines](../../results/baselines.md)": baseline_rows(name),
        "as the tuning chose, [benchmark](../../results/benchmark.md)": (
            benchmark_rows(name)
        ),
        "own episodes, too, [fine-tuning](../../results/fine-tuning.md)": (
            fine_tuning_rows(name)
        ),
    }
    lines = [
        (
            row["dataset"],
            row.get("task") or task_of(row),
            how,
            str(row["seeds"]),
            rate_with_interval(row),
            f"{row['return']:.2f}" if "return" in row else "-",
            engine_named(row),
        )
        for how, rows in sources.items()
        for row in rows
    ]
    if not lines:
        return "None are committed yet.\n"
    columns = "dataset", "task", "how", "seeds", "goals reached [%]", "return", "engine"
    return markdown_table(columns, lines)


def _algorithms_index() -> str:
    rows = [
        (
            f"[{NAMES[name]}]({name}.md)",
            f"`{algorithm.loss}`".replace("|", "\\|"),
            algorithm.learns,
            algorithm.source,
        )
        for name, algorithm in ALGORITHMS.items()
    ]
    return (
        "# Algorithms\n\n**From good data start with MABC. If there are failures or "
        "random steps among them, compare MAICQ and MATD3+BC. If the episodes of a team "
        "follow several conventions, take best-of-n students. Without data take DDPG + "
        "HER.**\n\n"
        + markdown_table(("algorithm", "loss of the actors", "learns", "source"), rows)
    )


# --- Datasets ----------------------------------------------------------------


def _dataset_page(name: str) -> str:
    """The card of a dataset that ships, but for where it lies here."""
    card = load_dataset(name).card()
    rows = card_markdown(card).split("\n\n")[1]
    kept = [line for line in rows.splitlines() if not line.startswith("| path |")]
    share = card["success"]
    about = (
        f"**{card['steps']:,} steps in {card['episodes']} episodes of `{card['task']}`, "
        f"by the {card['collector']} agent, which reaches its goal in all of them that "
        f"are kept: {share['forward']['episodes']} ahead, "
        f"{share['backward']['episodes']} behind.** It ships with the package, so that "
        f"`marl-mm train mabc --dataset {name}` starts at once; MABC and TD3+BC learn to "
        "reach nearly every goal from it. As all of it is good, no critic sees from it "
        "what a bad action is worth.\n"
    )
    drawing = f"![Returns and alphas of {name}](../../images/card-{name}.svg)\n"
    return "\n".join((f"# {name}\n", about, drawing, "\n".join(kept), ""))


PAGES: dict[str, Callable[[], str]] = {
    "reference/algorithms/index.md": _algorithms_index,
    **{
        f"reference/algorithms/{name}.md": partial(_algorithm_page, name)
        for name in ALGORITHMS.names()
    },
    "reference/datasets/good-5k.md": partial(_dataset_page, "good-5k"),
}
"""Path below docs/, and what makes the page."""
