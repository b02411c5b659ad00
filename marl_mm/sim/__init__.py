"""The simulator: a folder for each engine, and nowhere else its import."""
