"""The simulator: the only package that imports PyBullet."""
