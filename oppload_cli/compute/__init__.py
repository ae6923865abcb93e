"""Compiled loops that replace functions of the models, and the one door to them."""
