"""Figures, tables and the page, drawn from saved results."""
