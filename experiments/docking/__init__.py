"""The docking study: how exactly, how softly and how surely each way of docking ends, in worlds like real ones."""
