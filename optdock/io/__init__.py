"""Readers and writers of files: maps, plan files, YAML with line numbers, and error messages of one form."""
