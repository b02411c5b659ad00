"""The robot in PyBullet; ``engine.py`` alone imports it."""
