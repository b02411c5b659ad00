"""The whole-body controller: tasks, limits, priorities, hierarchy."""
