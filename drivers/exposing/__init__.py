"""A whole camera made of any language: one exposure at a time, when its middle was, its scale."""

from drivers.exposing.camera import ExposingCamera

__all__ = ["ExposingCamera"]
