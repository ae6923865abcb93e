"""Tools for developers of oppload; not part of the package."""
