"""Experiments: scripts that import the library; nothing imports them."""
