"""Surveys: where a robot can dock from, and where a dock should stand."""
