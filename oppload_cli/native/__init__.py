"""The inner loops in C, where a compiler was at hand when the package was built."""
