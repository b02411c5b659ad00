"""The robot in MuJoCo, and its part of the compiled step."""
