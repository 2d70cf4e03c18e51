"""Manifest, Snakefile and runner: what to do in which order."""
