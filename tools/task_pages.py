"""Reference pages of tasks, made of the registry, the tasks' files and the results."""

import ast
import inspect
import json
import lzma
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import fields, is_dataclass
from functools import partial
from operator import attrgetter
from typing import Any

from committed_rows import (
    NAMES,
    RESULTS,
    ROOT,
    engine_named,
    offline_rows,
    online_rows,
    task_of,
)
from reference_pages import field_texts

from marl_mm.envs.registry import TASKS, kind_of
from marl_mm.envs.task import Task
from marl_mm.envs.tasks.bar import Bar
from marl_mm.envs.tasks.carry import Carry
from marl_mm.envs.tasks.course import Course
from marl_mm.envs.tasks.grasp import Grasp
from marl_mm.envs.tasks.moving_reach import MovingReach
from marl_mm.envs.tasks.reach import Reach
from marl_mm.eval.tables import markdown_table, rate_with_interval
from marl_mm.layout import Entry, Layout
from marl_mm.registry import BUILT_IN
from marl_mm.sim.config import RECORDED_ENGINE
from marl_mm.versions import engine_text

OURS = [name for name in TASKS.names() if TASKS.origin(name) == BUILT_IN]
"""Built-in tasks, without those of installed plug-ins."""

SHOWN = [name for name in OURS if kind_of(name) == name]
"""Tasks that have a page: of a kind in several levels the medium one."""

WHAT = {
    "Reach-v0": "The paper's task: bring the hand to within 5 cm of a goal ahead of the "
    "robot or behind it.",
    "SmoothReach-v0": "Reach, where the base's jerk costs, so that alpha matters.",
    "PreciseReach-v0": "Reach to within 2 cm, from a start that eight random steps made.",
    "CarryReach-v0": "Reach with a block of unknown mass, up to 3 kg, in the hand.",
    "Grasp-v0": "Lift a block 10 cm, and hold it off its stand for a second.",
    "GraspReach-v0": "Take a block from its stand, and bring it to a goal as in Reach.",
}
"""What there is to do in tasks that share a class; others have it in ``about``."""

STRIPS = {
    "SmoothReach-v0": "smooth-reach.png",
    "PreciseReach-v0": "precise-reach.png",
    "CarryReach-v0": "carry-reach.png",
    "Grasp-v0": "grasp.png",
    "GraspReach-v0": "grasp-reach.png",
    "QuietZone-v0": "quiet-zone.png",
    "Gate-v0": "gate.png",
    "Tray-v0": "tray.png",
    "MovingReach-v0": "moving-reach.png",
    "Bar-v0": "bar.png",
    "Course-v0": "course.png",
}
"""Film strip of the script by task; Reach-v0 shows the pretrained agent's."""


def _task_page(name: str) -> str:
    task = TASKS.get(name)
    picture, actor = "reach.png", "the pretrained agent on Reach-v0"
    words, more = "pretrained", ", and with `--direction forward`"
    if name in STRIPS:
        picture, actor = STRIPS[name], "the script"
        words, more = f"scripted --task {name}", ""
        for way in task.conventions[1:]:
            more = f", and with `--scripted.convention {way}`"
    results = _task_results(name)
    film = (
        f"![Film: the script at work](../../images/{picture[:-4]}.webp)\n\n"
        if (ROOT / f"docs/images/{picture[:-4]}.webp").exists()
        else ""
    )
    parts = [
        f"# {name}\n",
        " ".join((f"**{_aim(name)}**", _ends(task), *_best(name))) + "\n",
        f"{film}![Film strip: {actor} at work](../../images/{picture})\n",
        f"{'Film and film strip' if film else 'Film strip'} of {actor}, drawn by PyBullet{_worlds(task)}. Try it: `marl-mm play "
        f"{words} --video FILE.mp4`{more}.\n",
        *_team(task),
        *_levels(name),
        "## What is seen\n",
        _entries(task.layout, task.layout.state, "sees"),
        "Compared with the goal: "
        f"{_listed(task.layout.compared)} with {_listed(task.layout.desired)}.\n",
        "## What is set\n",
        _entries(task.layout, task.layout.action, "sets"),
        "## Reward\n",
        _reward(task),
        "## Numbers\n",
        f"Fields of `{type(task).__module__}.{type(task).__name__}` that are not its "
        "defaults: " + (_changed(task) or "none") + ". Replace any of them: "
        f'`gymnasium.make("marl_mm/{name}", overrides={{...}})`, and of many at once '
        f'`marl_mm.make_vec("{name}", 8, overrides={{...}})`.\n',
        *(["## Results\n", results] if results else []),
    ]
    return "\n".join(parts)


def _worlds(task: Task) -> str:
    return "; each picture shows the world of every robot" * (task.robots > 1)


def _aim(name: str) -> str:
    return WHAT.get(name) or TASKS.get(name).about


def _team(task: Task) -> Iterator[str]:
    """What the task's file says below its first line, if it says more."""
    text = inspect.getdoc(sys.modules[type(task).__module__]) or ""
    _, _, more = text.partition("\n\n")
    if more:
        yield "## Why the team decides\n"
        yield more.replace("``", "`") + "\n"


def _levels(name: str) -> Iterator[str]:
    """Fields of the levels of a kind of task that differ, if it has levels."""
    levels = {level: TASKS.get(level) for level in OURS if kind_of(level) == name}
    if len(levels) == 1:
        return
    rows = []
    for path, text in _settings(levels[name]):
        values = [_in_words(attrgetter(path)(task)) for task in levels.values()]
        if len(set(values)) > 1 or path == "max_steps":
            rows.append((f"`{path}`", *values, text))
    yield "## Levels\n"
    yield markdown_table(("field", *(f"`{n}`" for n in levels), "meaning"), rows)


def _settings(config: Any, of: str = "") -> Iterator[tuple[str, str]]:
    """Fields of a config and of those in it, by their paths, with what they mean."""
    texts = field_texts(type(config))
    for item in fields(config):
        value = getattr(config, item.name)
        if is_dataclass(value):
            yield from _settings(value, f"{of}{item.name}.")
        else:
            yield f"{of}{item.name}", texts[item.name]


def _in_words(value: Any) -> str:
    if isinstance(value, tuple):
        return " to ".join(f"{end:g}" for end in value)
    return {False: "no", True: "yes"}[value] if isinstance(value, bool) else str(value)


def _ends(task: Task) -> str:
    failed = ", when it fails" * task.fails
    return (
        f"An episode ends when the goal is reached{failed}, or after {task.max_steps} "
        "steps of 1 s."
    )


def _best(name: str) -> Iterator[str]:
    offline = [
        row
        for row in offline_rows()
        if task_of(row) == name and row["setting"] in NAMES
    ]
    if not offline:
        return
    best = max(offline, key=lambda row: float(row["success"]))
    online = [row for row in online_rows() if row["task"] == name]
    learnt = max(online, key=lambda row: float(row["success_last"]), default=None)
    text = (
        f"Learnt from data, {NAMES[best['setting']]} reaches {100 * best['success']:.1f} "
        "% of its goals"
    )
    if learnt is None:
        yield f"{text}; it was not tried online."
    else:
        reached = f"{100 * learnt['success_last']:.1f} %"
        yield f"{text}; learnt online, {learnt['about']} reaches {reached}."


def _entries(layout: Layout, entries: Sequence[Entry], verb: str) -> str:
    rows = [
        (
            f"`{entry.name}`",
            "" if entry.unit == "1" else entry.unit,
            f"[{entry.low:g}, {entry.high:g}]" if abs(entry.low) < 1e9 else "",
            ", ".join(a.name for a in layout.team if entry.name in getattr(a, verb)),
        )
        for entry in entries
    ]
    who = "seen by" if verb == "sees" else "set by"
    return markdown_table(("entry", "unit", "bounds", who), rows)


def _listed(names: Iterable[str]) -> str:
    return ", ".join(f"`{name}`" for name in names)


def _reward(task: Task) -> str:
    if not isinstance(task, Reach):
        return _reward_of_team(task)
    jerk = f", less {task.jerk_weight:g} of the base's rms jerk within the step [m/s^3]"
    text = (
        f"{task.goal_reward:g} where the goal is reached, to within "
        f"{100 * task.success_distance:g} cm at the end of a step; else minus the "
        f"distance [m]. Less {task.ee_error_weight:g} d_mm and "
        f"{task.base_error_weight:g} d_mp, how far hand and base are from their targets "
        f"at the step's end [m]{jerk if task.jerk_weight else ''} (paper, Eq. 6 to 9). "
        "The agents share it.\n"
    )
    if not isinstance(task, Carry):
        return text
    return (
        f"{text}\nA failure ends the episode and brings {task.load.failure_reward:g}: "
        f"{_FAILURES_OF_GRASP if isinstance(task, Grasp) else 'a drop or a collision'}. "
        '`info["reason"]` says which. Nothing but friction holds the block; '
        '`{"load": {"grasp": "weld"}}` fixes it to the hand instead. '
        "The policy does not see what a block weighs; the controller "
        "weighs it by the joints' torques "
        '(`{"load": {"knowledge": "given"}}` tells it).\n'
    )


_FAILURES_OF_GRASP = "a missed grasp, a drop, a collision, or a block out of reach"


def _reward_of_team(task: Any) -> str:
    failures = ", ".join(f'"{reason}"' for reason in _reasons(task))
    if isinstance(task, Bar):
        failures += ', or "collision of" two links'
    if isinstance(task, Course):
        return (
            f"A point for each of the {task.highest_return:g} sub-goals that is reached "
            "in the step; the last one ends the episode. The agents share it.\n\n"
            f"A failure ends the episode and brings {task.failure_reward:g}: {failures}, "
            'or what went wrong with the block. `info["reason"]` says which.\n'
        )
    where = f"{task.goal_reward:g} where the goal is reached"
    if isinstance(task, MovingReach):
        return f"{where}; else minus the distance to it [m]. The agents share it.\n"
    return (
        f"{where}, to within {100 * task.success_distance:g} cm at the end of a step; "
        "else minus the distance [m]. The agents share it.\n\n"
        f"A failure ends the episode and brings {task.failure_reward:g}. "
        f'`info["reason"]` says which: {failures}.\n'
    )


def _reasons(task: Task) -> Iterator[str]:
    """Strings that the task's file assigns to what is called reason or failure."""
    for node in ast.walk(
        ast.parse(inspect.getsource(sys.modules[type(task).__module__]))
    ):
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]).endswith(
            ("reason", "failure")
        ):
            for part in ast.walk(node.value):
                if isinstance(part, ast.Constant) and part.value:
                    yield str(part.value)


def _changed(task: Task) -> str:
    return ", ".join(_differing(task, type(task)()))


def _differing(of: Any, usual: Any, path: str = "") -> Iterator[str]:
    for item in fields(of):
        value, default = getattr(of, item.name), getattr(usual, item.name)
        if is_dataclass(value):
            yield from _differing(value, default, f"{path}{item.name}.")
        elif value != default:
            yield f"`{path}{item.name}` {value}"


def _task_results(name: str) -> str:
    rows = []
    path = RESULTS / f"script/{name}.json.xz"
    if path.exists():
        (evaluation,) = json.loads(lzma.decompress(path.read_bytes()))
        summary = evaluation["summary"]["all"]
        low, high = (100 * bound for bound in evaluation["interval"])
        reached = f"{100 * evaluation['success_rate']:.1f} [{low:.1f}, {high:.1f}]"
        engine = engine_text(RECORDED_ENGINE, evaluation["packages"])
        rows.append(("the script", "", reached, f"{summary['return']:.2f}", engine))
    for row in offline_rows():
        if task_of(row) == name:
            rows.append(
                (
                    NAMES[row["setting"]],
                    f"from {row['dataset']}",
                    rate_with_interval(row),
                    f"{row['return']:.2f}",
                    engine_named(row),
                )
            )
    for row in online_rows():
        shown = any(what in row["setting"] for what in ("demonstrations", "imitation"))
        departures = row["setting"].count("-") > 1 and not shown
        if row["task"] == name and not departures:
            reached = rate_with_interval(row, "success_last")
            who = f"online, {row['episodes']} episodes"
            result = reached, f"{row['return_last']:.2f}", engine_named(row)
            rows.append((row["about"], who, *result))
    if not rows:
        return ""
    header = ("policy", "learnt", "goals reached [%]", "return", "engine")
    return (
        markdown_table(header, rows)
        + "\nThree seeds, 200 goals, last checkpoint, 95 % intervals; [what they mean]"
        "(../../results/index.md).\n"
    )


def _tasks_index() -> str:
    paper = [name for name in SHOWN if isinstance(TASKS.get(name), Reach)]
    team = [name for name in SHOWN if name not in paper]
    return (
        "# Tasks\n\nEach is a Gymnasium goal environment `marl_mm/TASK` and a PettingZoo "
        "parallel one, `parallel_env(TASK)`.\n\n"
        "## The paper's task, and blocks\n\n"
        "The first three differ in numbers only; the others have a block. "
        "Start with `Reach-v0`; compare algorithms on `GraspReach-v0` and on the coordination "
        "tasks below, which separate them.\n\n"
        + _overview(paper)
        + "\n## The team decides\n\n"
        "What one agent has to know, another one sees. Each is registered in three "
        "levels: `Gate-easy-v0`, `Gate-v0`, which is the medium one, and "
        "`Gate-hard-v0`, and so on. In `QuietZone-halves-v0` and `Gate-halves-v0` an "
        "episode is half of the way, for data to be stitched. `Bar-v0` has two robots "
        "and four agents.\n\n"
        + _overview(team)
        + "\n## Blocks and stands\n\n<!-- drawn -->\n<!-- /drawn -->\n"
    )


def _overview(shown: Sequence[str]) -> str:
    rows = [
        (f"[{name}]({name}.md)", _aim(name), str(task.max_steps), _sizes(task))
        for name, task in ((name, TASKS.get(name)) for name in shown)
    ]
    return markdown_table(("task", "aim", "steps", "state, action"), rows)


def _sizes(task: Task) -> str:
    return f"{len(task.layout.state)}, {len(task.layout.action)}"


PAGES: dict[str, Callable[[], str]] = {
    "reference/tasks/index.md": _tasks_index,
    **{f"reference/tasks/{name}.md": partial(_task_page, name) for name in SHOWN},
}
"""Path below docs/, and what makes the page."""
