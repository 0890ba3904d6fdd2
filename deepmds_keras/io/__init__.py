"""Errors, files and tables: the lowest floor, which imports nothing of the project."""
