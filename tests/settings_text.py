"""Settings of services in tests: what all of them begin with."""

SERVICE_AND_SITE = """
[service]
port = 0
[solving]
worker = false
blind = "never"
[site]
latitude_deg = 47.0
longitude_deg = 11.0
"""
"""A free port, no process for solving, and a site in the Alps; telescopes follow."""

FREE_GERMAN_MOUNT = """
[[telescope]]
id = "east"
[telescope.mount]
url = "{url}"
mounting = "german"
[telescope.camera]
kind = "folder"
path = "{folder}"
[telescope.limits]
sun_cone_deg = 5.0
min_altitude_deg = 5.0
past_meridian_east_deg = 180.0
past_meridian_west_deg = 180.0
"""
"""A German mount at `{url}` with the sky on both sides of the meridian, and files as its camera."""
