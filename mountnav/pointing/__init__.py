"""Where a mount's believed place and the solved place meet: offsets and limits."""
