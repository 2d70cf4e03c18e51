"""Interpolation of curves between two poses."""
