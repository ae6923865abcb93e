"""Pages: a result as one HTML file with its video, curves and alarms in sync."""
