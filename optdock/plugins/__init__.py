"""Plugins: their interfaces, life cycle, parameters and outcomes, and the registry that finds them."""
