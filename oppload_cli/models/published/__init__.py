"""Looming detectors by other authors, each as its authors programmed it (``docs/detectors.md``)."""
