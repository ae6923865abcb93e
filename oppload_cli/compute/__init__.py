"""Compiled loops that replace functions of the models, and the module that loads them."""
