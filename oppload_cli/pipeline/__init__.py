"""The path of one input from its frames to its result files."""
