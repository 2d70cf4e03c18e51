"""Scans of all poses to one mesh topology in correspondence."""
