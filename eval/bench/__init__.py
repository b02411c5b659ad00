"""Benchmarks of controller, learning and data, beside rival references."""

SB3 = "sb3-ddpg-her"
"""Name of Stable-Baselines3's DDPG + HER in results."""
