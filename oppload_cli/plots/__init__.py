"""Figures, made from results only."""
