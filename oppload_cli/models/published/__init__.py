"""Looming detectors of the field, each as its authors wrote it (``docs/detectors.md``)."""
