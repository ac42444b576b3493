"""Readers and writers of files: maps, plan files, YAML with line numbers, and uniform error messages."""
