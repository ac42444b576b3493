"""Contract suites for plugins, and drives with known time laws."""
