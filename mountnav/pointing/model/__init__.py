"""Pointing models: what axes, tube and bearings do to where a telescope looks, fitted to looks at the sky."""
