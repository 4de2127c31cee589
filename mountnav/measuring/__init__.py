"""A frame becomes measurements: background, detection, profile fit, flags."""
