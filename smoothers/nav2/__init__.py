"""Nav2's geometric smoothers, as baselines and for old parameter files; they are not part of the certified method."""
