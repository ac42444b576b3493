"""Path smoothers: plugins of `optdock.smoothers`."""
