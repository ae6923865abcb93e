"""Video in and out: sources of luminance frames, and writers."""
