"""Whether `optdock.calibration` finds what is hidden: simulated robots of the field world, their drives, their truths."""
