"""Contract suites of plugins, and drives with known time laws."""
