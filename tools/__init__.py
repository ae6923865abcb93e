"""Tools for those who work on oppload itself; no part of the package."""
