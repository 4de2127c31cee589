"""The virtual observatory: its settings, the mount that it has, targets for the demo."""
