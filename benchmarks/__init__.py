"""Figures of cost, each against a reference; see README.md."""
