"""Plugins: their interfaces, life cycle, parameters and results, and the registry that finds them."""
