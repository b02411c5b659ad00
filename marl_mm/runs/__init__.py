"""The application below the command line: collect, train, evaluate, play.

Python and the commands call the same functions, which print nothing.
"""
