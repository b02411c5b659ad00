"""Multi-agent offline reinforcement learning on a simulated mobile manipulator."""

import gymnasium

__version__ = "0.1.0"

for _task in (  # those of marl_mm.envs.config.TASKS, without importing it; tested
    "Reach-v0",
    "SmoothReach-v0",
    "PreciseReach-v0",
    "CarryReach-v0",
    "Grasp-v0",
    "GraspReach-v0",
):
    gymnasium.register(
        id=f"marl_mm/{_task}",
        entry_point="marl_mm.envs.reach:ReachEnv",
        kwargs={"task": _task},
    )
