"""Disk formats: every reader and writer of the suite."""
