"""Nav2's geometric smoothers, for comparison and for old parameter files; the certified method does not use them."""
