"""Errors of interpolation and of the ground truth itself."""
