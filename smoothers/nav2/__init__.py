"""Nav2's geometric smoothers, as baselines and for old parameter files: no part of the certified method."""
