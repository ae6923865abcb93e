"""Tuning: one stimulus over a sweep, through the models, without writing videos."""
