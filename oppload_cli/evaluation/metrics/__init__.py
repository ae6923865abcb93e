"""How often a detector is right on labelled clips, from its responses alone."""
