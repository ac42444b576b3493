"""The independent certificate: proves a path or trajectory, or names what is broken and where."""
