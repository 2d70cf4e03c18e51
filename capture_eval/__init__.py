"""Photogrammetry ground-truth evaluation of facial shape interpolation."""

__version__ = "0.1.0"
