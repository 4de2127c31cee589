"""The telescopes of the service: put together from the settings, opened, restarted, let go."""
