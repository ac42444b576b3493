"""Readers and writers of files: maps, plans, dock databases, Nav2 parameters."""
