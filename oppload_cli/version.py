"""The version, in a module of its own so that the build can read it without importing oppload."""

__version__ = "1.0.0rc1"
