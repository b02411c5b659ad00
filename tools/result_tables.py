"""Tables of README and pages, made of the committed results."""

import json
import lzma
import re
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path

from named_pages import other_named, recipes_table
from study_tables import (
    baselines_table,
    differences_table,
    disturbances_table,
    engine_differences_table,
    fine_tuning_table,
    goals_table,
    hindsight_in_words,
    known_table,
    separation_table,
    steps_table,
    updates_table,
)
from sweep_tables import (
    alpha_table,
    load_table,
    response_table,
    responses,
)
from sweep_tables import worth_table as sweep_worth_table

from marl_mm.cli import COMMANDS, LISTS
from marl_mm.envs.load import StandConfig
from marl_mm.envs.registry import TASKS
from marl_mm.envs.tasks.carry import Carry
from marl_mm.envs.tasks.grasp import LAYOUT as HANDLING
from marl_mm.envs.tasks.reach import LAYOUT as REACH
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
from marl_mm.eval.metrics import Row
from marl_mm.eval.rows import read_rows
from marl_mm.eval.studies.alpha import worth_table as alpha_worth_table
from marl_mm.eval.studies.benchmark import OVERALL, PAIRS
from marl_mm.eval.studies.benchmark import TABLE as BENCHMARK
from marl_mm.eval.studies.benchmark_tables import (
    benchmark_table,
    overall_table,
    pairs_table,
)
from marl_mm.eval.studies.budgets import (
    BUDGETS_FIGURE,
    BUDGETS_TABLE,
    SELECTION_TABLE,
    budgets_table,
    selection_table,
)
from marl_mm.eval.studies.coordination import TABLE as TEAMS
from marl_mm.eval.studies.coordination import (
    WORTH,
    coordination_table,
    levels_table,
    worth_table,
)
from marl_mm.eval.studies.early import TABLE as EARLY
from marl_mm.eval.studies.early import early_table
from marl_mm.eval.studies.engines import AGREEMENT, FIGURE, TABLE
from marl_mm.eval.studies.engines_summary import agreement_table
from marl_mm.eval.studies.offline import BLOCKS
from marl_mm.eval.studies.robustness_summary import (
    CROSS_PLAY,
    cross_play_table,
    robustness_table,
)
from marl_mm.eval.studies.robustness_summary import TABLE as ROBUSTNESS_TABLE
from marl_mm.eval.studies.rows import RowStore
from marl_mm.eval.studies.table import CRITICS, IQM, RETURN, Table
from marl_mm.eval.studies.targets import STUDIES
from marl_mm.eval.studies.tuning import TABLE as TUNED_TABLE
from marl_mm.eval.studies.tuning import tuning_table
from marl_mm.eval.tables import markdown_table, rate_with_interval
from marl_mm.sim.config import RECORDED_ENGINE
from marl_mm.versions import engine_text

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "eval" / "results"


def _alpha() -> str:
    return alpha_table(read_rows(RESULTS / "alpha/alpha.csv"), "Reach-v0", "blend")


def _responses() -> str:
    return response_table(responses(read_rows(RESULTS / "alpha/alpha.csv")))


def _worth() -> str:
    return sweep_worth_table(read_rows(RESULTS / "alpha/worth.csv"))


def _loads() -> str:
    return load_table(read_rows(RESULTS / "alpha/loads.csv"))


def _env() -> str:
    paths = sorted((RESULTS / "env").glob("*.json"), reverse=True)  # Reach first
    results = {path.stem: json.loads(path.read_text("utf-8")) for path in paths}
    return "\n".join(table(results) for table in (env_table, vector_table, tick_table))


def _bench() -> str:
    return bench_table(
        json.loads((RESULTS / "controller/bench.json").read_text("utf-8"))
    )


def _abuse() -> str:
    forms = ("blend", "rhp")
    paths = {form: RESULTS / f"controller/abuse-{form}.json" for form in forms}
    return abuse_table(
        {f: json.loads(path.read_text("utf-8")) for f, path in paths.items()}
    )


def _data() -> str:
    return data_table(json.loads((RESULTS / "data/bench.json").read_text("utf-8")))


_ONLINE = (
    "ddpg",
    "ddpg-her",
    "maddpg-her",
    "ddpg-paper",
    "ddpg-her-paper",
    "ddpg-demonstrations",
    "ddpg-her-demonstrations",
    "ddpg-her-smooth",
    "maddpg-her-smooth",
    "ddpg-her-grasp",
    "ddpg-her-grasp-demonstrations",
    "sb3-ddpg-her",
)
"""Rows of the README's table; all are in the committed one."""


def _online() -> str:
    rows = read_rows(RESULTS / "studies/online.csv")
    shown = [row for row in rows if row["setting"] in _ONLINE]
    table = Table(STUDIES["online"].part(None, _ONLINE), shown)
    return f"{table.markdown([IQM])}\n{hindsight_in_words(shown)}"


def _learnt() -> str:
    return alpha_worth_table(read_rows(RESULTS / "studies/alpha_worth.csv"))


def _steps() -> str:
    return steps_table(RowStore(RESULTS / "studies/rows"))


def _updates() -> str:
    return updates_table(json.loads((RESULTS / "online/bench.json").read_text("utf-8")))


def _ablation(name: str, *leave_out: str, dataset: str = "") -> str:
    """A table of offline learning; what is left out stands in the committed one."""
    rows = read_rows(RESULTS / f"studies/{name}.csv")
    study = STUDIES[name].part([dataset] if dataset else None, None)
    return Table(study, rows).markdown(("IQM [%]", *leave_out))


def _drawn_from(name: str, draw: Callable[[list[Row]], str]) -> str:
    """A table of rows that are made in hours, or that they are not made yet."""
    path = RESULTS / "studies" / name
    if not path.exists():
        return "Not run yet.\n"
    return draw(read_rows(path))


def _fine_tuning(summary: list[Row]) -> str:
    return fine_tuning_table(RowStore(RESULTS / "studies/rows"), summary)


def _figure(name: str, about: str) -> str:
    """A figure of what is made in hours, or that it is not made yet."""
    if not (RESULTS / "studies" / name).exists():
        return "Not run yet.\n"
    return f"![{about}](../../eval/results/studies/{name})\n"


def _transfer(rows: list[Row]) -> str:
    return Table(STUDIES["transfer"], rows).markdown(("IQM [%]", *_NOT_TRANSFERRED))


def _grasp(rows: list[Row]) -> str:
    return Table(STUDIES["grasp"], rows).markdown([IQM, "paper [%]"])


@cache
def recorded_engines() -> str:
    """The engines of the committed rows of studies that name none in their tables."""
    records = (
        json.loads(p.read_text("utf-8")) for p in RESULTS.glob("studies/rows/*/*.json")
    )
    # Cells name the engine among their settings; their pages say which.
    old = [record for record in records if not {"engine", "cells"} & record.keys()]
    packages = [record["packages"] for record in old if "packages" in record]
    engines = {engine_text(RECORDED_ENGINE, versions) for versions in packages}
    return " and ".join(sorted(engines))


def _simulated() -> str:
    return f"Tables on pages that name no engine are of {recorded_engines()}.\n"


def _over_imitation(name: str) -> str:
    """How the others compare with MABC."""
    return differences_table(STUDIES[name], RowStore(RESULTS / "studies/rows"), "mabc")


def _script() -> str:
    """The script on the goals that those who learn from it are evaluated on."""
    lines = []
    for task in (source.task for source in BLOCKS):
        packed = (RESULTS / f"script/{task}.json.xz").read_bytes()
        (evaluation,) = json.loads(lzma.decompress(packed))
        every = evaluation["summary"]["all"]
        row = {
            "success": evaluation["success_rate"],
            "success_interval": evaluation["interval"],
        }
        reached = rate_with_interval({**row, "seeds": 1})
        numbers = f"{every['steps_to_success']:.1f}", f"{every['return']:.2f}"
        lines.append((task, str(every["episodes"]), reached, *numbers))
    header = ("task", "goals", "reached by the script [%]", "steps", "return")
    return markdown_table(header, lines)


def _offline_updates() -> str:
    return offline_speed_table(
        json.loads((RESULTS / "offline/bench.json").read_text("utf-8"))
    )


def _gpu_updates() -> str:
    return gpu_table(json.loads((RESULTS / "offline/gpu.json").read_text("utf-8")))


def _entries() -> str:
    """Entries of joint state and action, and whose they are, as Markdown."""
    only = [f"`{name}`" for name, task in TASKS.items() if task.layout == HANDLING]
    sides = [
        ("seen by", HANDLING.state_names, REACH.state_names, "observation"),
        ("set by", HANDLING.action_names, REACH.action_names, "action"),
    ]
    lines: dict[tuple[str, ...], list[str]] = {}
    for verb, names, everywhere, part in sides:
        for number, name in enumerate(names):
            agents = [a.name for a in HANDLING.agents if number in getattr(a, part)]
            where = "all" if name in everywhere else ", ".join(only)
            thing = re.sub("_[xyz]$", "", name)
            line = thing, f"{verb} {' and '.join(agents)}", where
            lines.setdefault(line, []).append(f"`{name}`")
    header = ("entry", "whose", "tasks")
    return markdown_table(
        header, [(", ".join(n), who, where) for (_, who, where), n in lines.items()]
    )


def _drawn() -> str:
    """What is drawn of blocks and stands, and what a failure brings, as Markdown."""
    loads = {name: task.load for name, task in TASKS.items() if isinstance(task, Carry)}
    load = StandConfig()
    lines = [
        (what, *(f"{scale * end:g}" for end in interval))
        for what, interval, scale in (
            ("mass [kg]", load.mass, 1),
            ("edge [mm]", load.edge, 1000),
            ("friction against the pads", load.friction, 1),
            ("stand's place, x [m]", load.stand_x, 1),
            ("stand's place, y [m]", load.stand_y, 1),
            ("stand's height [m]", load.stand_height, 1),
        )
    ]
    costs = ", ".join(
        f"{load.failure_reward:g} in `{name}`" for name, load in loads.items()
    )
    table = markdown_table(("drawn for each episode", "from", "to"), lines)
    return f"{table}\nReward of a failure, which ends the episode: {costs}.\n"


def _known() -> str:
    return known_table(read_rows(RESULTS / "known.csv"))


_PAPER, _DIFFERENCE = "paper [%]", "difference [points]"

_NOT_LONG = ("d_mm [m]", "d_mp [m]", "alpha", CRITICS["q_slope"])
"""Columns of the committed table that the README leaves out."""

_NOT_NEAR = ("every seed", RETURN, "d_mm [m]", "d_mp [m]", "alpha", *CRITICS.values())
"""Columns that do not depend on the distance within which a goal is reached."""

_NOT_HELD = ("every seed", "d_mm [m]", "d_mp [m]", _PAPER, _DIFFERENCE)
"""Columns that do not tell what the second agent is worth."""

_NOT_TRANSFERRED = (
    *("every seed", _PAPER, _DIFFERENCE, "d_mm [m]", "d_mp [m]", "alpha"),
    *CRITICS.values(),
)
"""Columns that do not tell how agents do on the other engine."""

_NOT_CURED = ("dataset", _PAPER, _DIFFERENCE, "d_mm [m]", "d_mp [m]", "alpha")
"""Columns that tell nothing of why learning fails."""


def _commands() -> str:
    """The commands, and those that list what is registered."""
    lines = [(f"`marl-mm {name}`", about) for name, about in COMMANDS.items()]
    lists = ", ".join(f"`{name}`" for name in LISTS)
    lines.append((lists, "list what is registered, and where it comes from"))
    return markdown_table(("command", "what it does"), lines)


TABLES: dict[str, Callable[[], str]] = {
    "commands": _commands,
    "entries": _entries,
    "drawn": _drawn,
    "alpha": _alpha,
    "responses": _responses,
    "worth": _worth,
    "loads": _loads,
    "bench": _bench,
    "env": _env,
    "abuse": _abuse,
    "data": _data,
    "online": _online,
    "grasp": partial(_drawn_from, "grasp.csv", _grasp),
    "learnt": _learnt,
    "steps": _steps,
    "updates": _updates,
    "offline": partial(_ablation, "offline", _DIFFERENCE, *CRITICS.values()),
    "tasks": partial(_ablation, "tasks", _PAPER, _DIFFERENCE),
    "blocks": partial(_ablation, "blocks", _PAPER, _DIFFERENCE, "alpha"),
    "tasks-over-mabc": partial(_over_imitation, "tasks"),
    "within": partial(_ablation, "within", *_NOT_NEAR, _PAPER, _DIFFERENCE),
    "held": partial(_ablation, "held", *_NOT_HELD, *CRITICS.values()),
    "table4": partial(_ablation, "table4", *_NOT_LONG),
    "table5": partial(_ablation, "table5", *_NOT_LONG),
    "cures": partial(_ablation, "cures", *_NOT_CURED, dataset="good-30k"),
    "script": _script,
    "simulated": _simulated,
    "transfer": partial(_drawn_from, "transfer.csv", _transfer),
    "engines-figure": partial(
        _figure,
        FIGURE,
        "Goals that policies reach on one engine against the other, by task",
    ),
    "budgets-figure": partial(
        _figure, BUDGETS_FIGURE, "Goals that the chosen policy reaches, over episodes"
    ),
    "engines-agreement": partial(_drawn_from, AGREEMENT, agreement_table),
    "engines-differences": partial(_drawn_from, TABLE, engine_differences_table),
    "baselines": partial(_drawn_from, "baselines.csv", baselines_table),
    "separation": partial(_drawn_from, "separation.csv", separation_table),
    "fine-tuning": partial(_drawn_from, "fine-tuning.csv", _fine_tuning),
    "benchmark": partial(_drawn_from, BENCHMARK, benchmark_table),
    "benchmark-overall": partial(_drawn_from, OVERALL, overall_table),
    "benchmark-pairs": partial(_drawn_from, PAIRS, pairs_table),
    "early": partial(_drawn_from, EARLY, early_table),
    "tuning": partial(_drawn_from, TUNED_TABLE, tuning_table),
    "budgets": partial(_drawn_from, BUDGETS_TABLE, budgets_table),
    "selection": partial(_drawn_from, SELECTION_TABLE, selection_table),
    "disturbances": disturbances_table,
    "robustness": partial(_drawn_from, ROBUSTNESS_TABLE, robustness_table),
    "cross-play": partial(_drawn_from, CROSS_PLAY, cross_play_table),
    "coordination-worth": partial(_drawn_from, WORTH, worth_table),
    "coordination-teams": partial(_drawn_from, TEAMS, coordination_table),
    "coordination-levels": partial(_drawn_from, TEAMS, levels_table),
    "recipes": recipes_table,
    "named-others": other_named,
    "offline-updates": _offline_updates,
    "gpu-updates": _gpu_updates,
    "known": _known,
    "goals": goals_table,
}
"""Name of the marks, and what stands between them."""
