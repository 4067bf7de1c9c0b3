"""Generated input for everything that strangers can reach: command lines, files and calls.

``python -m tests.system.fuzz --help`` runs it for as long as one likes.
"""
