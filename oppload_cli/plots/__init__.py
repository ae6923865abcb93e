"""Figures, from results only."""
