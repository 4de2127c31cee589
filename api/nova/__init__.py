"""The web API of nova.astrometry.net as a face of the service: images are uploaded, solved, and forgotten."""
