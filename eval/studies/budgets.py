"""What tuning costs in episodes, and which policy to take without any.

Both are computed from the runs of the tuning: every run is a policy whose success is
known, beside scores that the data alone gave.

- By budget: a bandit (UCB1, Auer 2002) chooses which policy of an algorithm acts in the
  next episode; after so many the one with the highest mean is taken (as in Unifloral,
  arXiv 2504.11453). Beside it the expected best of some policies that are drawn and
  evaluated at length (Kurenkov and Kolesnikov 2022, arXiv 2110.04156).
- Without episodes: the rank correlation of a score with success, and the success that
  is lost by taking the policy with the highest score (regret at 1). A critic's own
  values are compared among policies of one algorithm and discount only.
"""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import scipy  # its stats take a second, and come when they are used
from matplotlib.figure import Figure

from marl_mm.algorithms.registry import preset
from marl_mm.eval.figures import save_small
from marl_mm.eval.grouping import grouped, mean_of
from marl_mm.eval.metrics import Row
from marl_mm.eval.rows import write_csv
from marl_mm.eval.tables import markdown_table, rate_in_interval

BUDGETS_TABLE, SELECTION_TABLE = "budgets.csv", "selection.csv"
"""Files of the tables."""

BUDGETS_FIGURE = "budgets.png"
"""File of the curves."""

BUDGETS = (0, 5, 10, 20, 50, 100, 200)
"""Numbers of episodes in the table."""

SCORES = ("cloning", "fqe", "fqe_agents", "critic")
"""Scores from data alone."""

_REPEATS = 500
"""Number of times that a bandit is run."""

_DRAWN, _EACH = 100, 20
"""Number of times that policies are drawn anew, and of bandits that choose of each."""


def found(rates: np.ndarray, episodes: int, seed: int = 0) -> np.ndarray:
    """Success of the policy that a bandit takes, after each number of episodes.

    Args:
        rates: Success rate of each policy in the episodes that it acts in, shape (n,),
            or of those of each bandit, shape (bandits, n).
        episodes: Largest number of episodes.
        seed: Seed of the order of the policies and of the episodes' ends.

    Returns:
        Shape (bandits, 1 + episodes); before any episode the first policy is taken.
    """
    rng = np.random.default_rng(seed)
    every = np.tile(rates, (_REPEATS, 1)) if rates.ndim == 1 else rates
    arms = rng.permuted(every, axis=1)
    counts, reached = np.zeros((2, *arms.shape))
    each = np.arange(len(arms))
    taken = [arms[:, 0]]
    for number in range(1, episodes + 1):
        tried = np.maximum(counts, 1)
        hopes = reached / tried + np.sqrt(2 * np.log(number) / tried)
        chosen = np.where(counts, hopes, np.inf).argmax(axis=1)
        counts[each, chosen] += 1
        reached[each, chosen] += rng.random(len(arms)) < arms[each, chosen]
        means = np.where(counts, reached / np.maximum(counts, 1), -1)
        taken.append(arms[each, means.argmax(axis=1)])
    return np.stack(taken, axis=1)


def deviation_of_found(rates: np.ndarray, episodes: int) -> np.ndarray:
    """Standard deviation of the mean of ``found``, by a bootstrap over settings.

    Args:
        rates: Success rate of each policy by setting, shape (settings, seeds): seeds of
            one setting are alike.
        episodes: Largest number of episodes.

    Returns:
        After each number of episodes, shape (1 + episodes,).
    """
    rng = np.random.default_rng(1)
    settings = rng.integers(len(rates), size=(_DRAWN, len(rates)))
    drawn = rates[settings].reshape(_DRAWN, -1).repeat(_EACH, axis=0)
    curves = found(drawn, episodes).reshape(_DRAWN, _EACH, -1)
    by_chance = curves.var(axis=1, ddof=1).mean(axis=0) / _EACH  # of so few bandits
    variance = curves.mean(axis=1).var(axis=0, ddof=1) - by_chance
    deviation: np.ndarray = np.sqrt(variance.clip(min=0.0))
    return deviation


def expected_best(rates: np.ndarray, count: int) -> float:
    """Expected largest of some success rates that are drawn with replacement.

    Args:
        rates: Success rate of each policy, shape (n,).
        count: Number that are drawn.
    """
    share = np.arange(len(rates) + 1) / len(rates)
    return float(np.sort(rates) @ np.diff(share**count))


def draw_budgets(rows: Sequence[Row], engine: str, folder: Path) -> None:
    """Write both tables and the curves, of the runs of the tuning.

    Args:
        rows: A row for each of them.
        engine: Engine of all, with its version.
        folder: Folder of tables and figure.
    """
    figure = Figure(figsize=(9, 4), layout="constrained")
    of_data = grouped(rows, "dataset")
    axes: Any = figure.subplots(1, len(of_data), sharey=True, squeeze=False)[0]
    budgets: list[Row] = []
    most = BUDGETS[-1]
    for axis, (dataset, on) in zip(axes, of_data.items(), strict=True):
        for number, (algorithm, some) in enumerate(grouped(on, "algorithm").items()):
            by_setting = [
                [row["success"] for row in of_setting]
                for of_setting in grouped(some, "changes").values()
            ]
            rates = np.ravel(by_setting)
            curve = found(rates, most)
            style = ("-", "--", ":")[number // 10]
            deviation = deviation_of_found(np.array(by_setting), most)
            mean, reach = curve.mean(axis=0), 1.96 * deviation
            ends = np.clip([mean - reach, mean + reach], 0, 1)
            axis.plot(100 * mean, style, lw=1.2, label=algorithm)
            about = {
                "dataset": dataset,
                "algorithm": algorithm,
                "engine": engine,
                "policies": len(rates),
            }
            bests = {
                "best_of_3": expected_best(rates, 3),
                "best_of_12": expected_best(rates, 12),
                "best": rates.max(),
            }
            for budget in BUDGETS:
                found_then = {
                    "episodes": budget,
                    "success": mean[budget],
                    "success_interval": tuple(ends[:, budget].tolist()),
                }
                budgets.append(about | found_then | bests)
        axis.set(title=dataset, xlabel="episodes for choosing", ylim=(-2, 102))
    axes[0].set(ylabel="goals that the chosen policy reaches [%]")
    axes[-1].legend(frameon=False, fontsize=7, loc="upper left", bbox_to_anchor=(1, 1))
    write_csv(folder / BUDGETS_TABLE, budgets)
    write_csv(folder / SELECTION_TABLE, _selections(of_data, engine))
    save_small(figure, folder / BUDGETS_FIGURE)


def _selections(of_data: dict[str, list[Row]], engine: str) -> list[Row]:
    """A row per dataset and score that the rows have."""
    return [
        {
            "dataset": dataset,
            "score": score,
            "engine": engine,
            **_selection(rows, score),
        }
        for dataset, on in of_data.items()
        for score in SCORES
        if (rows := [row for row in on if not np.isnan(row.get(score, np.nan))])
    ]


def _selection(rows: Sequence[Row], score: str) -> Row:
    """How a score chooses among all policies, and among those of one algorithm."""
    comparable = [{**row, "scale": _scale(row, score)} for row in rows]
    groups = grouped(comparable, "algorithm", "scale").values()
    within = [_chosen(some, score) for some in groups]
    ranked = [values for values in within if not np.isnan(values["correlation"])]
    among_all = _chosen(rows, score)
    if score == "critic":
        among_all = dict.fromkeys(among_all, np.nan)
    return {
        "policies": len(rows),
        **among_all,
        "groups": len(within),
        "correlation_within": mean_of(ranked, "correlation") if ranked else np.nan,
        "regret_within": mean_of(within, "regret"),
        "regret_random_within": mean_of(within, "regret_random"),
    }


def _scale(row: Row, score: str) -> float:
    """What values of the score are in units of: a critic's of its discount."""
    if score != "critic":
        return 0.0
    of_preset = getattr(preset(row["algorithm"]), "discount", 0.0)
    return float(json.loads(row["changes"]).get("discount", of_preset))


def _chosen(rows: Sequence[Row], score: str) -> Row:
    """Spearman's correlation of a score with success, nan of equals; regret at 1.

    Beside it stands the regret of one that is chosen at random.
    """
    scores, rates = (
        np.array([row[name] for row in rows], dtype=float)
        for name in (score, "success")
    )
    equal = np.ptp(scores) == 0 or np.ptp(rates) == 0
    correlation = np.nan if equal else scipy.stats.spearmanr(scores, rates).statistic
    return {
        "correlation": float(correlation),
        "regret": float(rates.max() - rates[scores.argmax()]),
        "regret_random": float(rates.max() - rates.mean()),
    }


def budgets_table(rows: Sequence[Row]) -> str:
    """Goals reached after some numbers of episodes, as Markdown."""
    lines = []
    for (dataset, algorithm), some in grouped(rows, "dataset", "algorithm").items():
        after = {row["episodes"]: row for row in some}
        rates = [
            rate_in_interval(after[n]["success"], after[n]["success_interval"])
            for n in BUDGETS
        ]
        best = (some[0][name] for name in ("best_of_3", "best_of_12", "best"))
        lines.append(
            [
                f"`{dataset}`",
                f"`{algorithm}`",
                *rates,
                *(f"{100 * r:.1f}" for r in best),
            ]
        )
    header = ["dataset", "algorithm", *(f"{n} episodes" for n in BUDGETS)]
    return markdown_table([*header, "best of 3", "best of 12", "best"], lines)


def _number(value: float, factor: float, digits: int) -> str:
    return "-" if np.isnan(value) else f"{factor * value:.{digits}f}"


def selection_table(rows: Sequence[Row]) -> str:
    """How the scores choose, as Markdown."""
    lines = [
        [
            f"`{row['dataset']}`",
            row["score"].replace("_", ", "),
            str(row["policies"]),
            _number(row["correlation"], 1, 2),
            _number(row["regret"], 100, 1),
            _number(row["regret_random"], 100, 1),
            f"{row['correlation_within']:.2f}",
            f"{100 * row['regret_within']:.1f}",
            f"{100 * row['regret_random_within']:.1f}",
        ]
        for row in rows
    ]
    header = ["dataset", "score", "policies", "correlation", "regret [points]"]
    within = ["correlation within an algorithm", "regret within one [points]"]
    random = "at random [points]"
    return markdown_table([*header, random, *within, random], lines)
