"""Motion vectors of a video, and their radial motion opponency (RMO)."""
