"""The simulator: a folder for each engine, which no other package imports."""
