"""Whether `optdock.calibration` finds what is hidden: robots of the field world, their drives, their truths."""
