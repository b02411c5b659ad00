"""Results of the benchmarks, as Markdown."""

from collections.abc import Mapping
from typing import Any

from marl_mm.eval.tables import markdown_table
from marl_mm.sim.config import ENGINES

ABUSE = {
    "joint_position_rad": ("joint position", "{:+.4f} rad"),
    "joint_velocity_share": ("joint velocity", "{:+.1%}"),
    "joint_torque_share": ("joint torque", "{:+.1%}"),
    "commanded_acceleration_share": ("acceleration, commanded", "{:+.2%}"),
    "measured_joint_acceleration_share": (
        "joint acceleration, over one tick of the simulator",
        "{:+.1%}",
    ),
    "measured_base_acceleration_share": (
        "base acceleration, over one tick of the simulator",
        "{:+.1%}",
    ),
    "base_speed_share": ("base speed", "{:+.1%}"),
    "base_yaw_rate_share": ("base yaw rate", "{:+.1%}"),
    "wheel_speed_share": ("wheel speed", "{:+.1%}"),
    "keep_out_m": ("keep-out plane", "{:+.4f} m"),
}
"""Limits watched by ``marl-mm bench abuse``: name and format of the worst excess."""


def abuse_table(results: Mapping[str, Mapping[str, Any]]) -> str:
    """Worst excess over each limit per form, as Markdown; negative: never reached."""
    lines = [
        (
            name,
            *(form.format(result["worst_excess"][key]) for result in results.values()),
        )
        for key, (name, form) in ABUSE.items()
    ]
    counts = (
        ("ticks", "ticks", "{}"),
        ("levels solved", "levels", "{}"),
        ("levels that failed", "failed_levels", "{}"),
        ("ticks that only braked", "safe_ticks", "{}"),
        ("least ZMP margin", "least_zmp_margin_m", "{:.3f} m"),
        ("largest tilt", "largest_tilt_rad", "{:.5f} rad"),
        ("largest wheel slip", "largest_wheel_slip_m_s", "{:.4f} m/s"),
        ("model's hand off the simulator's", "largest_model_ee_error_m", "{:.5f} m"),
        ("longest tick of the controller", "longest_controller_tick_us", "{:.0f} us"),
    )
    lines += [
        (name, *(form.format(result[key]) for result in results.values()))
        for name, key, form in counts
    ]
    return markdown_table(("worst excess over a limit", *results), lines)


def bench_table(result: Mapping[str, Any]) -> str:
    """Parts of a tick and other solvers on the same states, as Markdown."""
    names = {
        "tick": "whole tick",
        "simulation": "PyBullet's step",
        "io": "reading and commanding PyBullet",
        "controller": "controller: model and solving",
        "model": "model (Pinocchio)",
        "solve": "solving, Python included",
        "assembly": "assembly (compiled)",
        "levels": "levels without QPs (compiled)",
        "qp": "QPs (compiled)",
    }
    others = {
        "compiled": "compiled form, on the same states",
        "numpy_proxqp": "numpy and ProxQP",
        "numpy_daqp": "numpy and DAQP",
        "pink_weighted_qp": "Pink: one weighted QP, no torques",
    }
    step = result["us"]["simulation"]["median"]
    lines = []
    for table, part in ((names, result["us"]), (others, result["references_us"])):
        for key, name in table.items():
            if key in part:
                median, p99 = part[key]["median"], part[key]["p99"]
                ratio = f"{median / step:.2f}"
                lines.append((name, f"{median:.1f}", f"{p99:.0f}", ratio))
    return markdown_table(("part", "median [us]", "p99 [us]", "of a step"), lines)


def offline_speed_table(result: Mapping[str, Any]) -> str:
    """Updates per second of offline learners, and over others', as Markdown."""
    timings, seeds = result["offline"], result["seeds"]
    numbers = [key.removeprefix("threads_") for key in timings]
    first = next(iter(timings.values()))

    def cells(name: str) -> list[str]:
        rows = [timing[name] for timing in timings.values()]
        rates = [f"{row['updates_per_second']:.0f}" for row in rows]
        ratios = [
            f"{row['over_reference']:.2f}" if "reference" in row else "" for row in rows
        ]
        return [cell for pair in zip(rates, ratios, strict=True) for cell in pair]

    acting, beside = result["acting_ms"], result["side_by_side"]
    lines = [
        (
            *(name, row.get("reference", ""), *cells(name)),
            f"{acting[name]['p99']:.2f}" if name in acting else "",
        )
        for name, row in first.items()
    ]
    header = [
        f"{part}, {number} {'thread' if number == '1' else 'threads'}"
        for number in numbers
        for part in ("updates per second", "over reference")
    ]
    header.append("acting [ms]")
    table = markdown_table(("learner", "reference", *header), lines)
    count, cores = seeds["seeds"], seeds["cores"]
    single, several = (round(seeds[f"{n}_memory_mib"]) for n in ("one", "several"))
    return (
        f"{table}\nOne command with {count} seeds of TD3+BC on {cores} cores takes "
        f"{seeds['cost_over_one']:.2f} times as long as with one "
        f"({seeds['several_s']:.0f} s, {seeds['one_s']:.0f} s), and {several} MiB of "
        f"memory ({single} MiB). Side by side in one process, on one core, "
        f"5 take {5 * beside['1'] / beside['5']:.2f} times as long.\n"
    )


def gpu_table(result: Mapping[str, Any]) -> str:
    """Updates per second of seeds side by side on a GPU, as Markdown."""
    lines = []
    for name, rates in result["learners"].items():
        core = rates["core"]
        one, five, many = (rates["gpu"][seeds] for seeds in ("1", "5", "16"))
        several = f"{one:.0f}", f"{5 * one / five:.2f}", f"{many:.0f}"
        over = f"{many / one:.1f}", f"{many / core:.1f}"
        lines.append((name, f"{core:.0f}", *several, *over))
    header = (
        "learner",
        "one seed on a core",
        "one seed",
        "time of 5 seeds over one",
        "16 seeds, all together",
        "times one seed",
        "times a core",
    )
    title = f"{result['gpu']}, updates per second, of {result['options']['updates']}"
    return f"{title}:\n\n{markdown_table(header, lines)}"


def data_table(result: Mapping[str, Any]) -> str:
    """Costs of collecting, loading and storing, beside others', as Markdown."""
    rates, storage = result["steps_per_second"], result["storage"]
    lines = [
        ("steps per second of the bare environment", f"{rates['bare']:.0f}", ""),
        *(
            (
                f"collected, with --workers {name.removeprefix('workers_')}",
                f"{rates[name]:.0f}",
                f"{result[f'{name}_over_bare']:.2f} of the bare",
            )
            for name in rates
            if name != "bare"
        ),
        (
            f"loading {storage['steps']} steps of {storage['episodes']} episodes [s]",
            f"{storage['load_cached_s']:.2f}",
            f"Minari's reader {storage['minari_read_s']:.1f}; without the cache "
            f"{storage['load_cold_s']:.1f}",
        ),
        (
            "... memory [MB]",
            f"{storage['load_cached_memory_mb']:.0f}",
            "",
        ),
        (
            "... size on disk [MB]",
            f"{storage['size_mb']:.0f}",
            f"Minari's writer {storage['minari_size_mb']:.0f}; and the cache "
            f"{storage['cache_mb']:.0f}",
        ),
    ]
    return markdown_table(("what", "measured", "beside"), lines)


def env_table(results: Mapping[str, Mapping[str, Any]]) -> str:
    """Environment steps per second of the engines, by task, as Markdown."""
    lines, compiled = [], ("mujoco", "mujoco, loop in Python")
    for task, result in results.items():
        for alpha in ("random alpha", "alpha 1"):
            speed = result[f"{alpha}: steps/s"]
            times = result.get(f"{alpha}: times the steps/s of bullet", {})
            lines.append(
                (
                    f"`{task}`, {alpha}",
                    *(f"{speed[e]:.0f}" if e in speed else "-" for e in ENGINES),
                    *(f"{times[e]:.1f}" if e in times else "-" for e in compiled),
                )
            )
    head = ("task and alpha", "PyBullet, steps/s", "MuJoCo, steps/s", "of PyBullet's")
    return markdown_table((*head, "loop in Python, of PyBullet's"), lines)


def tick_table(results: Mapping[str, Mapping[str, Any]]) -> str:
    """Where the time of a compiled tick goes, by task, as Markdown."""
    key = "mujoco: us of a tick"
    ticks = {task: result[key] for task, result in results.items() if key in result}
    parts: Mapping[str, float] = next(iter(ticks.values()), {})
    lines = [(p, *(f"{tick[p]:.2f}" for tick in ticks.values())) for p in parts]
    return markdown_table(
        ("part of a tick", *(f"`{task}` [us]" for task in ticks)), lines
    )


def vector_table(results: Mapping[str, Mapping[str, Any]]) -> str:
    """Speed of a vector of environments over a single one, by task, as Markdown."""
    lines = []
    for task, result in results.items():
        settings = result["options"]
        count, workers = settings["vector"], settings["workers"]
        label = f"vector of {count}, {workers} workers: times the steps/s of one"
        speed = result[label]
        times = (f"{speed[e]:.2f}" if e in speed else "-" for e in ENGINES)
        lines.append((f"`{task}`", str(count), str(workers), *times))
    head = ("task", "environments", "workers", "PyBullet, of one", "MuJoCo, of one")
    return markdown_table(head, lines)
