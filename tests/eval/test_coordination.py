"""What teams are worth, by hand."""

from pathlib import Path

from marl_mm.eval.metrics import Row
from marl_mm.eval.rows import read_rows, write_csv
from marl_mm.eval.studies.coordination import (
    EXPERT,
    TABLE,
    WORTH,
    draw_coordination,
    worth_table,
)


def reached(team: str, *successes: int) -> list[Row]:
    """Rows of a team on as many goals; a goal takes ten steps more than the last."""
    head = {"policy": team, "engine": "mujoco 4", "seed": 0}
    return [
        {**head, "goal": goal, "success": success, "steps": 10 * (goal + 1)}
        for goal, success in enumerate(successes)
    ]


def test_the_worth_of_a_team_by_hand(tmp_path: Path) -> None:
    """The expert less the best alpha that is held, and the best random partner."""
    rows = [
        *reached(EXPERT, 1, 1, 1, 0),
        *reached("alpha 0", 0, 0, 0, 0),
        *reached("alpha 0.5", 1, 0, 0, 1)[::-1],  # paired by goal
        *reached("alpha 1", 0, 1, 0, 0),
        *reached("random hand", 0, 0, 0, 0),
        *reached("random balance", 0, 0, 1, 0),
        *reached("late balance", 1, 1, 1, 1),
    ]
    write_csv(tmp_path / "rows/coordination/Gate-v0.csv.xz", rows)
    teams = {row["team"]: row for row in draw_coordination(tmp_path, tmp_path)}
    assert teams[EXPERT]["success"] == 0.75 and teams[EXPERT]["steps"] == 20
    assert [*teams] == [row["team"] for row in read_rows(tmp_path / TABLE)]
    (worth,) = read_rows(tmp_path / WORTH)
    assert worth["best_constant"] == "alpha 0.5" and worth["constant"] == 0.5
    assert (worth["expert"], worth["difference"]) == (0.75, 0.25)
    assert worth["random_partner"] == 0.25
    low, high = worth["difference_interval"]
    assert low < 0.25 < high
    assert "| Gate-v0 | 75.0 | 50.0 (0.5) | 25.0 [" in worth_table([worth])
