"""Motion vectors of a video, and how much of the motion is radially opponent."""
